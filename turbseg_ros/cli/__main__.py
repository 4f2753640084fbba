# PYTHON_ARGCOMPLETE_OK
"""Starts the executables: as `turbseg_NAME`, or by `python -m turbseg_ros.cli NAME`.

Their modules take a second or two to load. A Ctrl-C meanwhile just ends the process, for there is
nothing to clean up yet; that is why this module itself loads nothing slow. What is asked of a
command line alone, such as `--help`, is answered before, and so without what they need.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
from argparse import ArgumentParser
from collections.abc import Callable

_ABOUT_ITSELF = ("-h", "--help", "--version")


# Set by a shell in which completion by argcomplete is registered.
_COMPLETES = "_ARGCOMPLETE"


def _complete(parser: ArgumentParser) -> None:
    """Answer the shell's question how the command line may go on, and end."""
    with contextlib.suppress(ImportError):
        importlib.import_module("argcomplete").autocomplete(parser)


def _starter(module: str) -> Callable[[], int]:
    def start() -> int:
        # Python's own handler would end in a traceback.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        parser = importlib.import_module(f"turbseg_ros.cli.parsers.{module}").build_parser()
        if _COMPLETES in os.environ:
            _complete(parser)
        asked = [argument for argument in sys.argv[1:] if argument in _ABOUT_ITSELF]
        if asked:
            parser.parse_args(asked)
        try:
            loaded = importlib.import_module(f"turbseg_ros.cli.{module}")
        except ImportError as error:
            from turbseg_ros.cli.errors import refuse_without

            return refuse_without(parser.prog, error)
        status: int = loaded.main()
        return status

    return start


node = _starter("node")
play = _starter("play")
replay = _starter("replay")
record = _starter("record")
evaluate = _starter("evaluate")
simulate = _starter("simulate")
import_ = _starter("import_")
benchmark = _starter("benchmark")
train = _starter("train")
demo = _starter("demo")
stages = _starter("stages")
real = _starter("real")
view = _starter("view")

_STARTERS = {
    "node": node,
    "play": play,
    "replay": replay,
    "record": record,
    "evaluate": evaluate,
    "simulate": simulate,
    "import": import_,
    "benchmark": benchmark,
    "train": train,
    "demo": demo,
    "stages": stages,
    "real": real,
    "view": view,
}


def main() -> int:
    """Run the executable that the first argument names; return its exit status."""
    name = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if name not in _STARTERS:
        print(f"usage: python -m turbseg_ros.cli {{{','.join(_STARTERS)}}} ...", file=sys.stderr)
        return 2
    return _STARTERS[name]()


if __name__ == "__main__":
    sys.exit(main())
