"""Measures motion in upcoming frames in a background thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass

from turbseg_ros.arrays import Matrix
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.moving import Moving
from turbseg_ros.segmentation.window import Neighbourhood


@dataclass(frozen=True)
class MotionJob:
    """A frame in which motion is to be measured, its neighbours, and the interval in use.

    `since_last` takes the processing pixels of the frame measured before, `frames` earlier, to
    this one's, None where there is none of the same scene; `objects` are expected in it, at detail
    resolution. `unfollowed` is what was measured last, if nothing was cut out since.
    """

    index: int
    neighbourhood: Neighbourhood
    interval: int
    since_last: Matrix | None = None
    frames: int = 1
    objects: Sequence[CroppedMask] = ()
    unfollowed: Moving | None = None


Measure = Callable[[MotionJob], "Moving | None"]
"""Measures what moves in a frame; None where there is too little to compare it with.

What is not `measured` says that nothing has begun to move.
"""


class MotionWorker:
    """Does the jobs it is given one after the other, and keeps the results until they are taken.

    :param measure: does a job, in the executor's thread.
    """

    def __init__(self, measure: Measure, executor: Executor) -> None:
        self._measure = measure
        self._executor = executor
        self._jobs: dict[int, Future[Moving | None]] = {}

    def submit(self, job: MotionJob) -> None:
        """Have a job done; jobs come in the order of their frames."""
        self._jobs[job.index] = self._executor.submit(self._measure, job)

    def take(self, index: int) -> Moving | None:
        """Wait for what moves in a frame; None where there was too little to compare it with."""
        return self._jobs.pop(index).result()

    def drop(self, index: int) -> None:
        """Forget the job of a frame, if there is one."""
        self._jobs.pop(index, None)

    def cancel(self) -> None:
        """Forget all jobs; those that haven't begun are not done."""
        for future in self._jobs.values():
            future.cancel()
        self._jobs.clear()
