"""Parameter files that come with the package, by name."""

from __future__ import annotations

import difflib
import os
import sys
from pathlib import Path

from turbseg_ros.parameters import ParameterError


def config_path(name: str) -> Path:
    """Return where a file of the package's `config` folder lies: in the source tree, or installed.

    A file that is nowhere gets the path it should have in the source tree.
    """
    source = Path(__file__).parents[1] / "config" / name
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(":")), sys.prefix]
    installed = (Path(prefix, "share/turbseg_ros/config", name) for prefix in prefixes)
    return next((path for path in (source, *installed) if path.is_file()), source)


def preset_path(name: str) -> Path:
    """Return the parameter file of a preset, as `severe`.

    :raises ParameterError: when there is none of that name; the text names those there are.
    """
    path = config_path(f"{name}.yaml")
    if path.is_file() and path.stem == name:
        return path
    names = sorted(path.stem for path in config_path("live.yaml").parent.glob("*.yaml"))
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(names)}"
    raise ParameterError(f"no preset {name!r}; {hint}")
