"""Whether something has travelled further than what shimmers would by chance.

Of what is not there, the place jitters: by the tilt of the air, by outlines that flicker, and by
as much as its surroundings are known to move without anything being there. Displacements that such
a jitter makes are normal in both axes, so that their length follows Rayleigh's distribution, and
the one that it exceeds as seldom as wanted is known.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from turbseg_ros.arrays import Point

# Frames in an hour. The displacement wanted grows with the logarithm's root: a factor of two in
# the camera's rate makes a thirtieth of it.
_FRAMES_PER_HOUR = 3600.0 * 30.0
# Accelerations that what is usual counts for, beside a track's own.
_USUAL_COUNT = 4.0
# Square of the median length of a two-axis normal variable, in variances of an axis.
_RAYLEIGH_MEDIAN_SQUARED = 2.0 * np.log(2.0)
# Jitter of a centroid that the noise of an outline leaves in calm air, in pixels.
_MIN_JITTER = 0.25


def chance_per_test(false_alarms_per_hour: float, every: int, tests: int) -> float:
    """Return how probable a false alarm may be each time that one track is judged.

    :param every: frames from one time to the next that all tracks are judged.
    :param tests: tracks that are judged at a time.
    """
    per_hour = _FRAMES_PER_HOUR / every * max(tests, 1)
    return min(false_alarms_per_hour / per_hour, 1.0)


def jitter(points: Sequence[Point], usual: float) -> float:
    """Estimate the rms jitter an axis of a track from the accelerations of its path.

    Accelerations are second differences of its places, which no steady motion has; their median
    leaves out jumps of an outline that was mended. The fewer there are, the more what is usual
    counts.

    :param points: (x, y) in one frame's pixels, one a frame, the oldest first.
    :param usual: rms jitter an axis to expect in pixels.
    """
    expected = max(usual, _MIN_JITTER) ** 2
    accelerations = np.diff(np.asarray(points, np.float64).reshape(-1, 2), n=2, axis=0)
    if not len(accelerations):
        return float(np.sqrt(expected))
    # Three places make an acceleration, the middle one twice; half of all lengths are below that.
    own = float(np.median(np.square(accelerations).sum(axis=1))) / (6.0 * _RAYLEIGH_MEDIAN_SQUARED)
    weight = len(accelerations) / (len(accelerations) + _USUAL_COUNT)
    return float(np.sqrt(weight * own + (1.0 - weight) * expected))


def significant_displacement(
    jitter: float, clutter: float, frames: int, steady: int, chance: float
) -> float:
    """Return the displacement that is exceeded by chance only so seldom, in pixels.

    Both its ends jitter, and in between a place with clutter wanders: it moves by `clutter` for
    some frames, then by another such motion.

    :param jitter: rms jitter an axis in pixels.
    :param clutter: rms motion of the place without anything being there, in pixels a frame.
    :param frames: frames from one end to the other.
    :param steady: frames for which the motion of clutter is the same.
    :param chance: how probable a longer displacement may be.
    """
    # Of two axes; displacements of independent motions add up as their squares do.
    clutter_variance = clutter**2 / 2.0 * steady * frames
    variance = 2.0 * jitter**2 + clutter_variance
    return float(np.sqrt(-2.0 * variance * np.log(chance)))
