"""Fuzz files of marked regions: whatever one holds, it is read, or refused in one line.

An input that begins with J is JSON behind that, any other is YAML.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["turbseg_ros", "yaml"]):
    from turbseg_ros.parameters import ParameterError
    from turbseg_ros.region_file import regions_in


def try_one(data: bytes) -> None:
    is_json = data[:1] == b"J"
    try:
        regions = regions_in(data[1:] if is_json else data, "regions", is_json=is_json)
    except ParameterError as error:
        assert str(error).isprintable()
        return
    for region in regions:
        assert region.name.isprintable()
        for size in ((1, 1), (16, 9), (9, 16)):
            mask = region.shape.mask(size)
            assert mask.shape == size[::-1]
            assert mask.any()
            assert len(region.shape.contours(size)) == 1
        assert region.limits.min_size <= region.limits.max_size


if __name__ == "__main__":
    atheris.Setup(sys.argv, try_one)
    atheris.Fuzz()
