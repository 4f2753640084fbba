"""The command line of `turbseg_node`, without what belongs to ROS."""

from __future__ import annotations

import argparse

from turbseg_ros.cli.options import add_preset_option, command_parser, parameter_names

INPUTS = (
    ("image_raw, image_raw/compressed", "Image, CompressedImage", "what is segmented"),
    ("camera_info", "CameraInfo", "beside it; places markers before the camera"),
)
OUTPUTS = (
    ("~/labels", "Image", "0 background, k the object with id k"),
    ("~/mask", "Image", "all objects together"),
    ("~/objects/slot_N/mask", "Image", "one object, whose slot it is while it lives"),
    ("~/centroids", "MarkerArray", "centroid, id, velocity and trail of each object"),
    ("~/annotations", "ImageMarker", "outlines"),
    ("~/image_annotations", "ImageAnnotations", "outlines and ids, with foxglove_msgs"),
    ("~/detections", "Detection2DArray", "boxes, ids and scores, with vision_msgs"),
    ("~/events", "DiagnosticStatus", "what enters, leaves, stops; the camera"),
    ("~/overlay", "Image", "outlines drawn on the image"),
    ("~/motion", "Image", "the motion map, pixels a frame"),
    ("~/clutter", "Image", "what places move by anyway, pixels a frame"),
    ("/diagnostics", "DiagnosticArray", "rates, latency, drops, turbulence"),
)
SERVICES = (
    ("~/reset", "Trigger", "start anew"),
    ("~/enable", "SetBool", "stop listening, and go on"),
)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_node",
        description="Segment what really moves before a camera, live. ROS arguments follow\n"
        "--ros-args: -r image_raw:=TOPIC, -p NAME:=VALUE, --params-file FILE,\n"
        "-r __ns:=/NAMESPACE.",
        epilog="\n".join(
            [
                *_table("topics that it listens to:", INPUTS),
                *_table("topics that it publishes:", OUTPUTS),
                *_table("services:", SERVICES),
                parameter_names(),
            ]
        ),
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add_preset_option(parser)
    return parser


def _table(title: str, rows: tuple[tuple[str, str, str], ...]) -> list[str]:
    width = max(len(name) for name, _, _ in rows)
    lines = [f"  {name.ljust(width)}  {what} ({kind})" for name, kind, what in rows]
    return [title, *lines, ""]
