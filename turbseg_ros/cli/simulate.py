"""`turbseg_simulate`: scenes, or somebody's own bag, through turbulent air into bags."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import IMAGE_TOPIC, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli.errors import (
    StopRequest,
    UsageError,
    executable,
    interrupted_after,
    stopping_at_signals,
)
from turbseg_ros.cli.options import with_progress
from turbseg_ros.cli.outputs import check_new
from turbseg_ros.cli.parsers.simulate import build_parser
from turbseg_ros.evaluation.labels import LabelsByStamp, read_labels
from turbseg_ros.messages.images import (
    ImageConversionError,
    encoding_of,
    image_from_message,
    message_from_image,
    stamp_to_ns,
)
from turbseg_ros.simulation.oncoming import ONCOMING, oncoming_scene
from turbseg_ros.simulation.render import render
from turbseg_ros.simulation.scenes import SCENES, Scene, UnknownSceneError, scene
from turbseg_ros.simulation.turbulence import Turbulence
from turbseg_ros.simulation.warp import ClipWarper

_FRAME_ID = "camera_optical_frame"
_MAX_TILT_PX = 20.0


@executable("turbseg_simulate")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status."""
    options = build_parser().parse_args(arguments)
    if options.list:
        _list_scenes()
        return 0
    _check(options)
    with stopping_at_signals("turbseg_simulate") as stop:
        if options.warp is not None:
            check_new(options.out)
            _warp_bag(options, stop)
        else:
            _render_bags(options, stop)
    return stop.status


def _render_bags(options: argparse.Namespace, stop: StopRequest) -> None:
    chosen = _chosen_scenes(options.scene, options.seed, options.out)
    for number, (each, path) in enumerate(chosen, start=1):
        strength = each if options.tilt is None else each.with_tilt(options.tilt)
        _render_bag(strength, options.seed, path, stop)
        if stop.cut:
            if number < len(chosen):
                left = f"{len(chosen) - number} of {len(chosen)} scenes were not begun"
                print(f"turbseg_simulate: {left}", file=sys.stderr)
            return


def _mark_partial(bag: BagWriter, path: Path, partial: str) -> None:
    """Let a bag be kept as far as it goes, and say so."""
    bag.mark_partial(partial)
    print(f"turbseg_simulate: {path} is partial: {partial}", file=sys.stderr)


def _check(options: argparse.Namespace) -> None:
    if options.out is None:
        raise UsageError("name the bag to be written with -o OUT")
    if options.tilt is not None and not 0 <= options.tilt <= _MAX_TILT_PX:
        raise UsageError(f"--tilt {options.tilt:g}: give 0 to {_MAX_TILT_PX:g} pixels")
    if options.seed < 0:
        raise UsageError(f"--seed {options.seed}: give 0 or more")
    if options.warp is not None and options.tilt is None:
        raise UsageError("--warp needs --tilt PX, the strength of the turbulence")


def _list_scenes() -> None:
    width = max(map(len, SCENES))
    for entry in (*SCENES.values(), oncoming_scene(0)):
        size = f"{entry.width}x{entry.height}"
        print(
            f"{entry.name:{width}}  {size:>7} {entry.sensor.encoding:6} {entry.frames:3} frames"
            f"  tilt {entry.turbulence.tilt_px:4.2f} px  {entry.summary}"
        )


def _chosen_scenes(name: str, seed: int, out: Path) -> list[tuple[Scene, Path]]:
    """Return the scenes to render and the bags to write; refuses before anything is rendered."""
    if name == "all":
        chosen = [(entry, out / entry.name) for entry in SCENES.values()]
    elif name == ONCOMING:
        chosen = [(oncoming_scene(seed), out)]
    else:
        try:
            chosen = [(scene(name, others=(ONCOMING, "all")), out)]
        except UnknownSceneError as error:
            raise UsageError(str(error)) from error
    for _, path in chosen:
        check_new(path)
    return chosen


def _render_bag(chosen: Scene, seed: int, path: Path, stop: StopRequest) -> None:
    taken = stop.until_stopped(render(chosen, seed))
    count = 0
    with BagWriter(path) as bag:
        for frame in with_progress(taken, chosen.name, chosen.frames):
            stamp = frame.stamp_ns
            encoding = chosen.sensor.encoding
            picture = message_from_image(frame.image, encoding, stamp, _FRAME_ID)
            truth = message_from_image(frame.labels, "mono16", stamp, _FRAME_ID)
            bag.write(IMAGE_TOPIC, picture, stamp)
            bag.write(TRUTH_TOPIC, truth, stamp)
            count += 1
        if stop.cut and not count:
            stop.check()
        if stop.cut:
            _mark_partial(bag, path, interrupted_after(count, chosen.frames))
            return
    print(f"{path}: {chosen.frames} frames of '{chosen.name}', seed {seed}")


def _warp_bag(options: argparse.Namespace, stop: StopRequest) -> None:
    """Write a bag whose frames and truth are warped and whose other messages are copied."""
    source, out, tilt, seed = options.warp, options.out, options.tilt, options.seed
    reader = BagReader(source)
    topic = reader.find_image_topic(options.image_topic)
    has_truth = TRUTH_TOPIC in reader.topics
    truth = LabelsByStamp(read_labels(reader, TRUTH_TOPIC) if has_truth else ())
    count = scored = 0
    with BagWriter(out) as bag:
        warper = None
        total = sum(topic.message_count for topic in reader.topics.values())
        taken = stop.until_stopped(reader.messages())
        for record in with_progress(taken, reader.path.name, total, "message"):
            if record.topic == TRUTH_TOPIC:
                continue  # goes with its frame
            if record.topic != topic:
                bag.write_serialized(record.topic, record.type_name, record.data, record.stamp_ns)
                continue
            message = record.message()
            stamp, frame_id = stamp_to_ns(message.header.stamp), message.header.frame_id
            try:
                image = image_from_message(message)
                if warper is None:
                    turbulence = Turbulence.typical(tilt, image.shape[1])
                    shape = image.shape[0], image.shape[1]
                    warper = ClipWarper(shape, turbulence, seed)
                seen, labels = warper.distort(image, truth.at(stamp, record.stamp_ns))
            except (ImageConversionError, ValueError) as error:
                raise BagError(f"{source}: image {count} on {topic}: {error}") from error
            picture = message_from_image(seen, encoding_of(seen), stamp, frame_id)
            bag.write(topic, picture, record.stamp_ns)
            if labels is not None:
                mask = message_from_image(labels, encoding_of(labels), stamp, frame_id)
                bag.write(TRUTH_TOPIC, mask, record.stamp_ns)
                scored += 1
            count += 1
        if stop.cut:
            _mark_partial(bag, out, interrupted_after(count, reader.topics[topic].message_count))
            return
    print(f"{out}: {count} frames, {scored} with truth, tilt {tilt:g} px, seed {seed}")
    if scored < len(truth):
        print(
            f"{len(truth) - scored} label images had no frame and were left out", file=sys.stderr
        )
