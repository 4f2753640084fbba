"""Regions of a clip's picture: a mask picture, or a file of marked regions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from turbseg_ros.arrays import Mask
from turbseg_ros.bag.errors import ClipError, reading
from turbseg_ros.datasets.images import IMAGE_SUFFIXES
from turbseg_ros.region_file import mask_picture, regions_in


def read_region(path: Path, shape: tuple[int, int]) -> Mask:
    """Return the region, HxW, of images of `shape` (height, width).

    `path` is a picture, white in the region, or a file like that of the parameter `regions.file`:
    all that is included, the whole picture where nothing is, but for what is ignored.

    :raises ClipError: when a picture is of another size.
    :raises ParameterError: when it is neither.
    """
    size = (shape[1], shape[0])
    with reading(path):
        content = path.read_bytes()
    if path.suffix.lower() in IMAGE_SUFFIXES:
        picture = mask_picture(content, str(path))
        if picture.size != size:
            raise ClipError(
                f"{path} is {picture.size[0]}x{picture.size[1]}, the frames {size[0]}x{size[1]}"
            )
        return picture.mask(size)
    marked = regions_in(content, str(path), is_json=path.suffix.lower() == ".json")
    included = [region.shape.mask(size) for region in marked if not region.ignored]
    found = np.any(included, axis=0) if included else np.ones(shape, bool)
    for region in marked:
        if region.ignored:
            found &= ~region.shape.mask(size)
    return np.asarray(found)
