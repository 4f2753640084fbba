"""The kinds of arrays that the package works on; shapes are said where they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[Any]
"""A camera's image, HxW or HxWxC, of any depth."""
ByteImage = npt.NDArray[np.uint8]
"""A picture of 8 bits, HxW or HxWxC."""
Labels = npt.NDArray[np.uint16]
"""HxW: 0 background, k the object with label k."""
Mask = npt.NDArray[np.bool_]
"""HxW: which pixels are meant."""
Map = npt.NDArray[np.float32]
"""HxW: a number for each pixel."""
Flow = npt.NDArray[np.float32]
"""HxWx2: a displacement (x, y) in pixels for each pixel."""
Matrix = npt.NDArray[np.float64]
"""3x3: takes homogeneous pixel coordinates (x, y, 1) to others.

Pixel centres lie at whole numbers."""
Point = npt.NDArray[np.float64]
"""(x, y) in pixels."""
