"""Live segmentation of moving objects seen through atmospheric turbulence."""

import os

__version__ = "0.2.0"

# Read by OpenCV when it is first imported: 16384 x 8192 pixels. A compressed image of some
# kilobytes may otherwise take gigabytes.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))
