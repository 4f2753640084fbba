"""Live segmentation of moving objects seen through atmospheric turbulence."""

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from turbseg_ros.library import MotionSegmenter as MotionSegmenter
    from turbseg_ros.parameters import ParameterError as ParameterError
    from turbseg_ros.parameters import Parameters as Parameters
    from turbseg_ros.segmentation.frame import Frame as Frame
    from turbseg_ros.segmentation.frame import MovingObject as MovingObject
    from turbseg_ros.segmentation.frame import SegmentationResult as SegmentationResult

__version__ = "0.2.0"

# Read by OpenCV when it is first imported: 16384 x 8192 pixels. A compressed image of some
# kilobytes may otherwise take gigabytes.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))

# What a library's user imports from here, and where it lies. `--help` and the build need none of
# it, nor what it needs itself.
_PUBLIC = {
    "MotionSegmenter": "turbseg_ros.library",
    "Parameters": "turbseg_ros.parameters",
    "ParameterError": "turbseg_ros.parameters",
    "Frame": "turbseg_ros.segmentation.frame",
    "MovingObject": "turbseg_ros.segmentation.frame",
    "SegmentationResult": "turbseg_ros.segmentation.frame",
}
__all__ = [
    "Frame",
    "MotionSegmenter",
    "MovingObject",
    "ParameterError",
    "Parameters",
    "SegmentationResult",
]


def __getattr__(name: str) -> Any:
    """Load what is public when it is first asked for (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)
