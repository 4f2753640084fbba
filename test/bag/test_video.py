"""Bags of video packets, decoded where PyAV is installed."""

from __future__ import annotations

import logging
import struct
import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.writer import Writer as McapWriter

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.segmentation.frame import Frame

FFMPEG = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
FOXGLOVE = "foxglove_msgs/msg/CompressedVideo"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
TOPIC = "/camera/video"
SECOND = 10**9
COUNT = 20


def pictures() -> list[np.ndarray]:
    """A bright square that moves over a gradient: coding costs it little."""
    ground = np.tile(np.linspace(40, 120, 96, dtype=np.uint8), (64, 1))
    images = []
    for number in range(COUNT):
        image = np.dstack([ground, ground, ground])
        image[20:36, 4 * number : 4 * number + 12] = (30, 60, 220)
        images.append(image)
    return images


def encoded(codec: str, frames: Sequence[np.ndarray], **options: str) -> list[tuple[int, bytes]]:
    """Return the packets of a stream in the order of coding, each with the number of its frame."""
    av = pytest.importorskip("av")
    if codec not in av.codecs_available:
        pytest.skip(f"PyAV was built without {codec}")
    context = av.CodecContext.create(codec, "w")
    height, width = frames[0].shape[:2]
    context.width, context.height, context.pix_fmt = width, height, "yuv420p"
    context.time_base, context.framerate = Fraction(1, 25), 25
    context.options = {"crf": "12", **options}
    packets = []
    for number, image in enumerate([*frames, None]):
        frame = None
        if image is not None:
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts = number
        packets += [(packet.pts, bytes(packet)) for packet in context.encode(frame)]
    return packets


def text(value: str) -> bytes:
    content = value.encode() + b"\0"
    return struct.pack("<I", len(content)) + content


def aligned(data: bytes, size: int) -> bytes:
    return data + bytes(-len(data) % size)


def serialised(type_name: str, stamp: int, encoding: str, data: bytes) -> bytes:
    """Return a message as DDS carries it, laid out by hand."""
    body = struct.pack("<iI", *divmod(stamp, SECOND)) + text("camera")
    if type_name == FFMPEG:
        body = aligned(body, 4) + struct.pack("<ii", 96, 64) + text(encoding)
        body = aligned(body, 8) + struct.pack("<QBB", 7, 1, 0)
    elif type_name == COMPRESSED:
        body = aligned(body, 4) + text(encoding)
    body = aligned(body, 4) + struct.pack("<I", len(data)) + data
    if type_name == FOXGLOVE:
        body = aligned(body, 4) + text(encoding)
    return b"\0\1\0\0" + body


def write(
    file: Path, type_name: str, encoding: str, packets: Sequence[tuple[int, bytes]]
) -> BagReader:
    with file.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(type_name, "ros2msg", b"")
        channel = writer.register_channel(TOPIC, "cdr", schema)
        for place, (number, data) in enumerate(packets):
            message = serialised(type_name, stamp_of(number), encoding, data)
            writer.add_message(channel, SECOND + place, message, SECOND)
        writer.finish()
    return BagReader(file)


def stamp_of(number: int) -> int:
    return 5 * SECOND + number * SECOND // 25


def read(reader: BagReader) -> tuple[list[Frame], BagFrames]:
    frames = BagFrames(reader, reader.find_image_topic())
    return list(frames), frames


@pytest.mark.parametrize(
    ("type_name", "codec", "encoding"),
    [
        (FFMPEG, "libx264", "libx264"),
        (FFMPEG, "libx264", "h264;yuv420p;bgr8;bgr8"),
        (FFMPEG, "libx265", "hevc_nvenc"),
        (FFMPEG, "libvpx-vp9", "libvpx-vp9"),
        (FOXGLOVE, "libx264", "h264"),
        (FOXGLOVE, "libx265", "h265"),
        (COMPRESSED, "libx264", "h264"),
    ],
)
def test_packets_become_the_frames_that_were_coded(
    tmp_path: Path, type_name: str, codec: str, encoding: str
) -> None:
    packets = encoded(codec, pictures())
    frames, source = read(write(tmp_path / "video.mcap", type_name, encoding, packets))
    assert [frame.stamp for frame in frames] == [stamp_of(number) for number in range(COUNT)]
    assert {frame.frame_id for frame in frames} == {"camera"}
    assert source.skipped == source.lost == 0
    for frame, image in zip(frames, pictures(), strict=True):
        assert np.abs(frame.image.astype(int) - image).mean() < 6


def test_frames_that_refer_to_later_ones_keep_their_stamps(tmp_path: Path) -> None:
    packets = encoded("libx264", pictures(), bf="2", **{"x264-params": "b-adapt=0"})
    numbers = [number for number, _ in packets]
    assert numbers != sorted(numbers)
    frames, _ = read(write(tmp_path / "video.mcap", FFMPEG, "libx264", packets))
    assert [frame.stamp for frame in frames] == [stamp_of(number) for number in range(COUNT)]
    for frame, image in zip(frames, pictures(), strict=True):
        assert np.abs(frame.image.astype(int) - image).mean() < 6


def test_what_comes_before_the_first_key_frame_is_counted_as_skipped(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    packets = encoded("libx264", pictures(), tune="zerolatency", g="8")[3:]
    frames, source = read(write(tmp_path / "video.mcap", FFMPEG, "h264", packets))
    assert frames[0].stamp == stamp_of(8)
    assert len(frames) + source.skipped == len(packets)
    assert source.skipped == 5


def test_a_damaged_packet_costs_no_more_than_the_stream_does(tmp_path: Path) -> None:
    packets = encoded("libx264", pictures(), tune="zerolatency", g="5")
    packets[7] = (7, b"\x13\x37" * 40)
    frames, source = read(write(tmp_path / "video.mcap", FOXGLOVE, "h264", packets))
    assert {stamp_of(number) for number in (*range(7), *range(10, COUNT))} <= {
        frame.stamp for frame in frames
    }
    assert len(frames) + source.skipped == COUNT


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 40])
@pytest.mark.parametrize("type_name", [FFMPEG, FOXGLOVE])
def test_a_message_that_is_no_packet_is_skipped_with_a_line(
    tmp_path: Path, type_name: str, data: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("av")
    with (tmp_path / "odd.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        channel = writer.register_channel(
            TOPIC, "cdr", writer.register_schema(type_name, "ros2msg", b"")
        )
        writer.add_message(channel, 1, data, 1)
        writer.finish()
    frames, source = read(BagReader(tmp_path / "odd.mcap"))
    assert (frames, source.skipped) == ([], 1)
    assert "image 0 of /camera/video skipped: video message" in caplog.text


def test_a_codec_that_is_not_known_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("av")
    frames, source = read(write(tmp_path / "odd.mcap", FFMPEG, "mjpeg2000", [(0, b"abc")]))
    assert (frames, source.skipped) == ([], 1)
    assert "video encoding 'mjpeg2000' is not supported" in caplog.text


@pytest.mark.parametrize(
    ("type_name", "transport"),
    [(FFMPEG, "ffmpeg"), (FOXGLOVE, "foxglove"), (COMPRESSED, "compressed")],
)
def test_without_pyav_a_line_names_the_command_that_makes_images(
    tmp_path: Path, type_name: str, transport: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    reader = write(tmp_path / "video.mcap", type_name, "h264", [(0, b"\0\0\0\1\x67")])
    with pytest.raises(BagError) as error:
        read(reader)
    assert how_to_install("av") in str(error.value)
    assert "ros2 run image_transport republish" in str(error.value)
    assert f"in_transport:={transport}" in str(error.value)
    assert "\n" not in str(error.value)


def test_pictures_stay_pictures_without_pyav(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    image = pictures()[0]
    data = cv2.imencode(".png", image)[1].tobytes()
    with caplog.at_level(logging.WARNING):
        frames, _ = read(write(tmp_path / "png.mcap", COMPRESSED, "bgr8; png", [(0, data)]))
    np.testing.assert_array_equal(frames[0].image, image)
    assert not caplog.records
