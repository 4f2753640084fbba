"""The command line of `turbseg_node`, without what belongs to ROS."""

from __future__ import annotations

import argparse

from turbseg_ros.cli.options import command_parser


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    return command_parser(
        prog="turbseg_node",
        description="Segment what really moves before a camera, live.",
        epilog="ROS arguments follow --ros-args: -r image_raw:=TOPIC, -p NAME:=VALUE, "
        "--params-file FILE, -r __ns:=/NAMESPACE.",
    )
