"""Recordings as other tools leave them: what is there is read, the rest left out with a line."""

from __future__ import annotations

import gzip
import json
import logging
import shutil
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import lz4.frame
import numpy as np
import pytest
import yaml
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rclpy.qos import DurabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Int32, String
from visualization_msgs.msg import MarkerArray

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.rosbags_file import ros1_converter
from turbseg_ros.bag.schema import canonical_type_name, message_definition
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.messages.images import image_from_message, message_from_image

IMAGE = "sensor_msgs/msg/Image"
TOPIC = "/camera/image_raw"
START = 1_772_366_400 * 10**9
COUNT = 12
PICTURES = [np.full((6, 8), 10 * number, np.uint8) for number in range(COUNT)]

AddChannels = Callable[[McapWriter], Callable[[int], None]]


def cdr(number: int, topic_frame: str = "camera") -> bytes:
    return serialize_message(
        message_from_image(PICTURES[number], "mono8", START + number, topic_frame)
    )


def write_mcap(
    file: Path,
    numbers: range = range(COUNT),
    *,
    beside: AddChannels | None = None,
    name: str = IMAGE,
    encoding: str = "ros2msg",
    **options: Any,
) -> Path:
    """Write the pictures of some numbers, recorded at START + number, as another recorder does."""
    with file.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start(profile="ros2", library="another recorder")
        schema = writer.register_schema(name, encoding, message_definition(IMAGE).text.encode())
        channel = writer.register_channel(TOPIC, "cdr", schema, {})
        write_beside = beside(writer) if beside else None
        for number in numbers:
            writer.add_message(channel, START + number, cdr(number), START + number)
            if write_beside:
                write_beside(number)
        writer.finish()
    return file


def read_numbers(reader: BagReader) -> list[int]:
    """Return the numbers of the pictures on the topic that is found to be the input."""
    records = list(reader.messages([reader.find_image_topic()]))
    numbers = [record.stamp_ns - START for record in records]
    for number, record in zip(numbers, records, strict=True):
        message = record.message()
        assert message.header.frame_id == "camera"
        np.testing.assert_array_equal(image_from_message(message), PICTURES[number])
    return numbers


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING]


@pytest.fixture
def without_rosbags(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    ros1_converter.cache_clear()


def write_images(
    file: Path,
    messages: dict[str, list[bytes]],
    kind: str = IMAGE,
    **options: Any,
) -> Path:
    """Write serialised images on topics, recorded at START and on."""
    with file.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start(profile="ros2", library="another recorder")
        schema = writer.register_schema(kind, "ros2msg", message_definition(kind).text.encode())
        for topic, listed in messages.items():
            channel = writer.register_channel(topic, "cdr", schema, {})
            for number, data in enumerate(listed):
                writer.add_message(channel, START + number, data, START + number)
        writer.finish()
    return file


def test_a_recording_of_a_topic_that_was_not_heard_says_so(tmp_path: Path) -> None:
    file = write_images(tmp_path / "a.mcap", {TOPIC: []})
    with pytest.raises(BagError, match=r"; nothing was recorded of /camera/image_raw:"):
        BagReader(file).find_image_topic()


@pytest.mark.parametrize("statistics", [True, False])
def test_of_many_cameras_the_only_one_that_was_heard_is_taken(
    tmp_path: Path, statistics: bool
) -> None:
    heard = {"/one/image_raw": [], TOPIC: [*map(cdr, range(COUNT))], "/other/image_raw": []}
    file = write_images(tmp_path / "a.mcap", heard, use_statistics=statistics)
    assert read_numbers(BagReader(file)) == [*range(COUNT)]


@pytest.mark.parametrize("index", [IndexType.NONE, IndexType.CHUNK, IndexType.ALL])
def test_a_converted_file_without_message_indexes_is_read(
    tmp_path: Path, index: IndexType
) -> None:
    file = write_mcap(tmp_path / "a.mcap", index_types=index)
    assert read_numbers(BagReader(file)) == [*range(COUNT)]


def test_images_that_a_converter_left_empty_are_skipped_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = write_images(tmp_path / "a.mcap", {TOPIC: [b""] * COUNT})
    frames = BagFrames(BagReader(file), TOPIC)
    assert list(frames) == []
    assert frames.skipped == COUNT
    assert any("image message is empty" in line for line in warnings(caplog))


def test_a_schema_without_text_and_a_profile_of_another_tool_change_nothing(
    tmp_path: Path,
) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="data_tool", library="another recorder")
        channel = writer.register_channel(TOPIC, "cdr", writer.register_schema(IMAGE, "", b""))
        for number in range(COUNT):
            writer.add_message(channel, START + number, cdr(number), START + number)
        writer.finish()
    assert read_numbers(BagReader(tmp_path / "a.mcap")) == [*range(COUNT)]


def test_a_recorder_that_stalls_and_writes_all_at_once_loses_no_frame(tmp_path: Path) -> None:
    period = 10**9 // 30
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(40):
            stalled = 10 <= number < 34
            recorded = 34 * period - (34 - number) * 1000 if stalled else number * period
            image = np.full((6, 8), number, np.uint8)
            stamped = message_from_image(image, "mono8", START + number * period)
            bag.write(TOPIC, stamped, START + recorded)
    frames = list(BagFrames(BagReader(tmp_path / "bag"), TOPIC))
    assert [frame.stamp for frame in frames] == [START + k * period for k in range(40)]
    assert not any(frame.begins_stream for frame in frames)


@pytest.mark.parametrize(
    "image_format", ["jpeg", "rgb8; jpeg compressed; bgr8", "bgr8; png compressed ", "", "JPG"]
)
def test_a_compressed_image_is_read_whatever_its_format_is_called(
    tmp_path: Path, image_format: str
) -> None:
    message = CompressedImage(format=image_format)
    message.data.frombytes(cv2.imencode(".jpg", np.full((6, 8, 3), 90, np.uint8))[1].tobytes())
    topic = f"{TOPIC}/compressed"
    data = [serialize_message(message)]
    kind = "sensor_msgs/msg/CompressedImage"
    reader = BagReader(write_images(tmp_path / "a.mcap", {topic: data}, kind))
    (frame,) = BagFrames(reader, reader.find_image_topic())
    assert frame.image.shape == (6, 8, 3)


# --- Channels that are none of ours -------------------------------------------------------------


def json_events(writer: McapWriter) -> Callable[[int], None]:
    schema = writer.register_schema("Event", "jsonschema", b'{"type": "object"}')
    channel = writer.register_channel("/events", "json", schema)
    return lambda n: writer.add_message(channel, START + n, json.dumps({"n": n}).encode(), START)


def protobuf_pictures(writer: McapWriter) -> Callable[[int], None]:
    schema = writer.register_schema("foxglove.RawImage", "protobuf", b"\x0a\x03abc")
    channel = writer.register_channel("/preview", "protobuf", schema)
    return lambda n: writer.add_message(channel, START + n, b"\x08\x01", START)


def no_schema(writer: McapWriter) -> Callable[[int], None]:
    channel = writer.register_channel("/notes", "json", 0)
    return lambda n: writer.add_message(channel, START + n, b"{}", START)


def cdr_without_schema(writer: McapWriter) -> Callable[[int], None]:
    channel = writer.register_channel("/odd", "cdr", 0)
    return lambda n: writer.add_message(channel, START + n, b"\0\1\0\0", START)


def no_encoding(writer: McapWriter) -> Callable[[int], None]:
    channel = writer.register_channel("/bytes", "", 0)
    return lambda n: writer.add_message(channel, START + n, b"", START)


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize(
    ("beside", "named"),
    [
        (json_events, "/events (json)"),
        (protobuf_pictures, "/preview (protobuf)"),
        (no_schema, "/notes (json, without a type)"),
        (cdr_without_schema, "/odd (cdr, without a type)"),
        (no_encoding, "/bytes (encoding unknown, without a type)"),
    ],
)
def test_channels_of_others_are_left_out_with_a_line(
    tmp_path: Path,
    beside: AddChannels,
    named: str,
    chunked: bool,
    caplog: pytest.LogCaptureFixture,
) -> None:
    file = write_mcap(tmp_path / "mixed.mcap", beside=beside, use_chunking=chunked)
    reader = BagReader(file)
    assert read_numbers(reader) == list(range(COUNT))
    assert list(reader.topics) == [TOPIC]
    assert [record.topic for record in reader.messages()] == [TOPIC] * COUNT
    assert len(warnings(caplog)) == 1
    assert named in warnings(caplog)[0]


def test_a_bag_without_ros_images_says_what_it_has_instead(tmp_path: Path) -> None:
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        protobuf_pictures(writer)(0)
        writer.finish()
    with pytest.raises(BagError, match=r"no image topic.*left out: /preview \(protobuf\)"):
        BagReader(tmp_path / "other.mcap").find_image_topic()
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/a", String(), 1)
    with pytest.raises(BagError, match=r"its topics: /a \(std_msgs/msg/String\)"):
        BagReader(tmp_path / "bag").find_image_topic()


def two_types(topic: str, first: int, second: int) -> AddChannels:
    def add(writer: McapWriter) -> Callable[[int], None]:
        text = writer.register_channel(
            topic, "cdr", writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        )
        number = writer.register_channel(
            topic, "cdr", writer.register_schema("std_msgs/msg/Int32", "ros2msg", b"int32 data")
        )
        texts, numbers = serialize_message(String(data="a")), serialize_message(Int32(data=1))

        def write(place: int) -> None:
            if place < first:
                writer.add_message(text, START + place, texts, START)
            if place < second:
                writer.add_message(number, START + place, numbers, START)

        return write

    return add


@pytest.mark.parametrize(("texts", "numbers"), [(3, 9), (9, 3), (4, 4)])
def test_of_a_topic_with_two_types_the_one_with_most_messages_is_read(
    tmp_path: Path, texts: int, numbers: int, caplog: pytest.LogCaptureFixture
) -> None:
    file = write_mcap(tmp_path / "two.mcap", beside=two_types("/status", texts, numbers))
    reader = BagReader(file)
    assert read_numbers(reader) == list(range(COUNT))
    kind = "std_msgs/msg/String" if texts >= numbers else "std_msgs/msg/Int32"
    assert reader.topics["/status"].type_name == kind
    assert reader.topics["/status"].message_count == max(texts, numbers)
    records = list(reader.messages(["/status"]))
    assert len(records) == max(texts, numbers)
    assert {record.type_name for record in records} == {kind}
    for record in records:
        record.message()
    assert f"{min(texts, numbers)} messages of" in warnings(caplog)[0]


def test_of_a_topic_with_two_types_images_go_first(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "two.mcap", range(4), beside=two_types(TOPIC, 4, 4))
    reader = BagReader(file)
    assert read_numbers(reader) == list(range(4))
    assert reader.topics[TOPIC].message_count == 4


def test_a_type_that_changes_from_one_file_to_the_next_is_no_fault(tmp_path: Path) -> None:
    write_mcap(tmp_path / "day_0.mcap", range(5), beside=two_types("/status", 5, 0))
    write_mcap(tmp_path / "day_1.mcap", range(5, 12), beside=two_types("/status", 0, 12))
    reader = BagReader(tmp_path)
    assert read_numbers(reader) == list(range(12))
    assert len(list(reader.messages(["/status"]))) == reader.topics["/status"].message_count


# --- Names of types -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "sensor_msgs/Image",
        "/sensor_msgs/Image",
        "/sensor_msgs/msg/Image",
        "sensor_msgs::msg::Image",
        "sensor_msgs::msg::dds_::Image_",
        "sensor_msgs.msg.Image",
        " sensor_msgs/Image\n",
    ],
)
@pytest.mark.parametrize("encoding", ["ros2msg", "ros2idl", "omgidl", ""])
def test_an_image_is_one_whatever_its_type_is_written_like(
    tmp_path: Path, name: str, encoding: str
) -> None:
    reader = BagReader(write_mcap(tmp_path / "odd.mcap", name=name, encoding=encoding))
    assert read_numbers(reader) == list(range(COUNT))
    assert reader.topics[TOPIC].type_name == IMAGE


@pytest.mark.parametrize(
    "name",
    ["", "Image", "../msg/Image", "a/srv/B", "a/msg/image", "a/msg/dds_/B", "a/b/C"],
)
def test_what_is_no_other_way_to_write_a_type_stays_as_it_is(name: str) -> None:
    assert canonical_type_name(name) == name


# --- Results of this node in the bag ------------------------------------------------------------


@pytest.mark.parametrize("node", ["/turbseg", "/north/turbseg", "/watcher", "/north/roof/watcher"])
def test_results_in_a_bag_are_not_taken_for_its_input(tmp_path: Path, node: str) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(3):
            at = START + number
            bag.write_serialized(TOPIC, IMAGE, cdr(number), at)
            bag.write(f"{node}/centroids", MarkerArray(), at)
            for name in ("labels", "mask", "objects/slot_0/mask", "overlay", "clutter"):
                bag.write(f"{node}/{name}", Image(), at)
            bag.write(f"{node}/overlay/compressed", Image(), at)
    reader = BagReader(tmp_path / "bag")
    assert reader.find_image_topic() == TOPIC
    assert reader.find_image_topic(f"{node}/overlay") == f"{node}/overlay"


def test_a_camera_beside_or_in_a_namespace_of_that_name_is_input(tmp_path: Path) -> None:
    for topic in ("/turbseg/image_raw", "/turbseg/camera/image_raw", "/overlay/image", "/mask"):
        folder = tmp_path / topic.replace("/", "_")
        with BagWriter(folder) as bag:
            bag.write_serialized(topic, IMAGE, cdr(0), START)
        assert BagReader(folder).find_image_topic() == topic


def test_of_the_transports_of_a_camera_the_raw_one_is_taken(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for topic in (f"{TOPIC}/compressed", TOPIC, f"{TOPIC}/compressedDepth"):
            bag.write_serialized(topic, IMAGE, cdr(0), START)
    assert BagReader(tmp_path / "bag").find_image_topic() == TOPIC


# --- Folders: splits, ring buffers, metadata ----------------------------------------------------


def split(folder: Path, numbers: range, each: int = 3, suffix: str = "") -> list[str]:
    """Write files of `each` pictures; the file numbers are those of the parts."""
    folder.mkdir()
    names = []
    for part in numbers:
        file = write_mcap(
            folder / f"{folder.name}_{part}.mcap", range(part * each, (part + 1) * each)
        )
        if suffix:
            (folder / f"{file.name}{suffix}").write_bytes(zstandard.compress(file.read_bytes()))
            file.unlink()
        names.append(file.name + suffix)
    return names


def write_metadata(folder: Path, names: list[str], **changes: object) -> None:
    information = {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": 1},
        "starting_time": {"nanoseconds_since_epoch": 1},
        "message_count": COUNT,
        "topics_with_message_count": [
            {"topic_metadata": {"name": TOPIC, "type": IMAGE}, "message_count": COUNT}
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": names,
    } | changes
    (folder / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": information})
    )


@pytest.mark.parametrize("storage", ["mcap", "", None])
def test_an_empty_storage_name_is_told_by_the_files(tmp_path: Path, storage: str | None) -> None:
    names = split(tmp_path / "bag", range(4))
    write_metadata(tmp_path / "bag", names, storage_identifier=storage)
    assert read_numbers(BagReader(tmp_path / "bag")) == list(range(COUNT))


def test_a_ring_buffer_without_metadata_is_read_from_the_first_file_it_has(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "ring"
    folder.mkdir()
    for part, number in ((9, 0), (10, 3), (11, 6)):  # in the order of numbers, not of letters
        write_mcap(folder / f"ring_{part}.mcap", range(number, number + 3))
    assert read_numbers(BagReader(folder)) == list(range(9))
    assert warnings(caplog) == []


def test_what_is_missing_between_the_files_of_a_recording_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    split(tmp_path / "bag", range(4))
    (tmp_path / "bag" / "bag_1.mcap").unlink()
    (tmp_path / "bag" / "bag_2.mcap").unlink()
    assert read_numbers(BagReader(tmp_path / "bag")) == [0, 1, 2, 9, 10, 11]
    assert "lacks 2 of its files (bag_1.mcap, bag_2.mcap)" in caplog.text


@pytest.mark.parametrize("pruned", [1, 3])
def test_files_that_a_ring_buffer_deleted_are_named_and_their_images_counted(
    tmp_path: Path, pruned: int, caplog: pytest.LogCaptureFixture
) -> None:
    names = split(tmp_path / "bag", range(4))
    write_metadata(tmp_path / "bag", names)
    for name in names[:pruned]:
        (tmp_path / "bag" / name).unlink()
    reader = BagReader(tmp_path / "bag")
    assert read_numbers(reader) == list(range(3 * pruned, COUNT))
    assert f"lacks {pruned} of its files" in caplog.text
    assert f"{3 * pruned} messages of {COUNT} are lost" in caplog.text
    assert reader.topics[TOPIC].message_count == COUNT


def test_files_that_an_old_metadata_does_not_know_are_read_too(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    names = split(tmp_path / "bag", range(4))
    write_metadata(tmp_path / "bag", names[:2])
    write_mcap(tmp_path / "bag" / "other.mcap")
    assert read_numbers(BagReader(tmp_path / "bag")) == list(range(COUNT))
    assert "out of date; bag_2.mcap, bag_3.mcap is read too" in caplog.text


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"no bag at all"])
@pytest.mark.parametrize("metadata", [True, False])
def test_a_file_of_several_that_holds_nothing_costs_itself(
    tmp_path: Path, content: bytes, metadata: bool, caplog: pytest.LogCaptureFixture
) -> None:
    names = split(tmp_path / "bag", range(4))
    (tmp_path / "bag" / names[3]).write_bytes(content)
    if metadata:
        write_metadata(tmp_path / "bag", names)
    assert read_numbers(BagReader(tmp_path / "bag")) == list(range(9))
    assert "left out: " in caplog.text
    assert "bag_3.mcap" in caplog.text


# --- Compressed as a whole, or message by message -----------------------------------------------

COMPRESSIONS = {".zstd": zstandard.compress, ".lz4": lz4.frame.compress, ".gz": gzip.compress}


@pytest.mark.parametrize("suffix", COMPRESSIONS)
def test_a_compressed_file_is_unpacked_and_leaves_nothing(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    plain = write_mcap(tmp_path / "plain.mcap")
    packed = tmp_path / f"recording.mcap{suffix}"
    packed.write_bytes(COMPRESSIONS[suffix](plain.read_bytes()))
    reader = BagReader(packed)
    assert read_numbers(reader) == list(range(COUNT))
    messages = reader.messages()
    next(messages)
    del reader  # what still reads keeps the file
    assert len(list(messages)) == COUNT - 1
    del messages
    assert list((tmp_path / "temporary").iterdir()) == []


@pytest.mark.parametrize("metadata", ["none", "with suffix", "without suffix"])
def test_a_folder_of_compressed_files_is_read(tmp_path: Path, metadata: str) -> None:
    names = split(tmp_path / "bag", range(4), suffix=".zstd")
    if metadata != "none":
        names = names if metadata == "with suffix" else [n.removesuffix(".zstd") for n in names]
        changes = {"compression_mode": "FILE", "compression_format": "zstd"}
        write_metadata(tmp_path / "bag", names, **changes)
    assert read_numbers(BagReader(tmp_path / "bag")) == list(range(COUNT))


def test_of_a_file_that_lies_there_twice_the_plain_one_is_read(tmp_path: Path) -> None:
    (name,) = split(tmp_path / "bag", range(1))
    (tmp_path / "bag" / f"{name}.zstd").write_bytes(b"\x28\xb5\x2f\xfd")  # killed meanwhile
    assert read_numbers(BagReader(tmp_path / "bag")) == [0, 1, 2]


@pytest.mark.parametrize("suffix", COMPRESSIONS)
def test_a_compressed_file_that_was_cut_is_read_up_to_there(
    tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    random = np.random.default_rng(0)
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(6):
            noise = random.integers(0, 255, (1050, 1000), np.uint8)
            bag.write(TOPIC, message_from_image(noise, "mono8", number), number)
    content = COMPRESSIONS[suffix]((tmp_path / "bag" / "bag_0.mcap").read_bytes())
    packed = tmp_path / f"cut.mcap{suffix}"
    packed.write_bytes(content[: len(content) * 2 // 3])
    assert len(list(BagReader(packed).messages())) == 3
    assert f"cut.mcap{suffix} is truncated" in caplog.text


def test_no_room_to_unpack_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = tmp_path / "recording.mcap.zstd"
    packed.write_bytes(zstandard.compress(write_mcap(tmp_path / "plain.mcap").read_bytes()))
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=2**20))
    with pytest.raises(BagError, match="set TMPDIR"):
        BagReader(packed)


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.NONE])
def test_chunks_of_another_compression_are_read(
    tmp_path: Path, compression: CompressionType
) -> None:
    file = write_mcap(tmp_path / "chunks.mcap", compression=compression, chunk_size=100)
    assert read_numbers(BagReader(file)) == list(range(COUNT))


# --- What a summary may leave out ---------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {"use_statistics": False},
        {"use_summary_offsets": False},
    ],
    ids=str,
)
def test_what_is_not_repeated_in_the_summary_is_found_and_is_no_damage(
    tmp_path: Path, options: dict, caplog: pytest.LogCaptureFixture
) -> None:
    file = write_mcap(tmp_path / "sparse.mcap", beside=json_events, chunk_size=100, **options)
    assert read_numbers(BagReader(file)) == list(range(COUNT))
    assert "damage" not in caplog.text


# --- SQLite and ROS 1 ---------------------------------------------------------------------------


def write_sqlite(folder: Path, **options: Any) -> Path:
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    if options:
        writer.set_compression(**options)
    with writer:
        connection = writer.add_connection(TOPIC, IMAGE, typestore=store)
        texts = writer.add_connection("/a", "std_msgs/msg/String", typestore=store)
        for number in range(COUNT):
            writer.write(connection, START + number, cdr(number))
            writer.write(texts, START + number, serialize_message(String(data=str(number))))
    return folder


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"mode": CompressionMode.FILE, "fmt": CompressionFormat.ZSTD},
        {"mode": CompressionMode.MESSAGE, "fmt": CompressionFormat.ZSTD},
    ],
    ids=["plain", "files", "messages"],
)
@pytest.mark.parametrize("metadata", [True, False])
def test_a_bag_in_sqlite_is_read(tmp_path: Path, options: dict, metadata: bool) -> None:
    folder = write_sqlite(tmp_path / "bag", **options)
    if not metadata:
        if options.get("mode") is CompressionMode.MESSAGE:
            pytest.skip("only the metadata says so")
        (folder / "metadata.yaml").unlink()
    reader = BagReader(folder)
    assert read_numbers(reader) == list(range(COUNT))
    assert reader.topics[TOPIC].message_count == COUNT
    assert reader.duration_ns == COUNT - 1
    texts = [record.message().data for record in reader.messages(["/a"])]
    assert texts == [str(number) for number in range(COUNT)]


def test_a_lone_sqlite_file_is_read(tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "bag") / "bag.db3"
    shutil.move(file, tmp_path / "alone.db3")
    assert read_numbers(BagReader(tmp_path / "alone.db3")) == list(range(COUNT))


def test_messages_of_mcap_that_are_compressed_one_by_one_are_read(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    with (folder / "bag_0.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(IMAGE, "ros2msg", b"")
        channel = writer.register_channel(TOPIC, "cdr", schema, {})
        for number in range(COUNT):
            data = zstandard.compress(cdr(number)) if number != 5 else b"spoilt"
            writer.add_message(channel, START + number, data, START)
        writer.finish()
    write_metadata(folder, ["bag_0.mcap"], compression_mode="MESSAGE", compression_format="zstd")
    assert read_numbers(BagReader(folder)) == [n for n in range(COUNT) if n != 5]


ROS1_IMAGE = get_typestore(Stores.ROS1_NOETIC)


def ros1(number: int) -> bytes:
    """Return a picture as ROS 1 serialises it, with the header's number of then."""
    types = ROS1_IMAGE.types
    stamp = types["builtin_interfaces/msg/Time"](sec=START // 10**9, nanosec=number)
    header = types["std_msgs/msg/Header"](seq=number, stamp=stamp, frame_id="camera")
    picture = PICTURES[number]
    height, width = picture.shape
    image = types[IMAGE](
        header=header,
        height=height,
        width=width,
        encoding="mono8",
        is_bigendian=0,
        step=width,
        data=picture.ravel(),
    )
    return bytes(ROS1_IMAGE.serialize_ros1(image, IMAGE))


def write_ros1(file: Path) -> Path:
    own = get_types_from_msg("int32 x\n", "my_msgs/msg/Odd")
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(own)
    with Ros1Writer(file) as writer:
        connection = writer.add_connection(TOPIC, IMAGE, typestore=store, latching=1)
        odd = writer.add_connection("/odd", "my_msgs/msg/Odd", typestore=store)
        for number in range(COUNT):
            writer.write(connection, START + number, ros1(number))
            writer.write(odd, START + number, b"\x01\0\0\0")
    return file


def test_a_ros_1_bag_is_read_as_far_as_ros_2_has_its_types(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    reader = BagReader(write_ros1(tmp_path / "old.bag"))
    assert read_numbers(reader) == list(range(COUNT))
    (first, *_) = reader.messages()
    assert (first.message().header.stamp.sec, first.stamp_ns) == (START // 10**9, START)
    assert reader.topics[TOPIC].qos[0].durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert "/odd (my_msgs/msg/Odd of ROS 1)" in caplog.text


def write_ros1_mcap(file: Path) -> Path:
    text = ROS1_IMAGE.generate_msgdef(IMAGE, ros_version=1)[0]
    with file.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros1", library="")
        schema = writer.register_schema("sensor_msgs/Image", "ros1msg", text.encode())
        channel = writer.register_channel(TOPIC, "ros1", schema)
        for number in range(COUNT):
            writer.add_message(channel, START + number, ros1(number), START)
        writer.finish()
    return file


def test_an_mcap_file_of_ros_1_is_read(tmp_path: Path) -> None:
    assert read_numbers(BagReader(write_ros1_mcap(tmp_path / "o.mcap"))) == list(range(COUNT))


@pytest.mark.parametrize(
    ("write", "command"),
    [
        (lambda path: write_sqlite(path / "bag"), "ros2 bag convert -i"),
        (lambda path: write_ros1(path / "old.bag"), "rosbags-convert --src"),
        (lambda path: write_ros1_mcap(path / "old.mcap"), "to read it as it is"),
    ],
    ids=["sqlite", "ROS 1", "MCAP of ROS 1"],
)
def test_without_rosbags_a_line_says_how_to_convert(
    tmp_path: Path, write: Callable, command: str, request: pytest.FixtureRequest
) -> None:
    bag = write(tmp_path)
    request.getfixturevalue("without_rosbags")
    with pytest.raises(BagError) as error:
        BagReader(bag)
    assert command in str(error.value)
    assert how_to_install("rosbags") in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["x.db3", "x.bag"])
@pytest.mark.parametrize("rest", [b"", bytes(4096), b"\xff" * 4096])
def test_what_only_begins_like_one_is_one_line(tmp_path: Path, name: str, rest: bytes) -> None:
    magic = b"SQLite format 3\0" if name == "x.db3" else b"#ROSBAG V2.0\n"
    (tmp_path / name).write_bytes(magic + rest)
    with pytest.raises(BagError, match=r"damaged.* convert it with") as error:
        BagReader(tmp_path / name)
    assert "\n" not in str(error.value)


def test_a_sqlite_file_that_is_cut_gives_what_it_has_or_one_line(tmp_path: Path) -> None:
    content = (write_sqlite(tmp_path / "bag") / "bag.db3").read_bytes()
    for tenths in range(1, 10):
        file = tmp_path / f"cut{tenths}.db3"
        file.write_bytes(content[: len(content) * tenths // 10])
        try:
            numbers = read_numbers(BagReader(file))
        except BagError as error:
            assert "\n" not in str(error)
        else:
            assert numbers == list(range(len(numbers)))


def test_a_journal_that_was_not_merged_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_sqlite(tmp_path / "bag")
    with sqlite3.connect(folder / "bag.db3") as connection:
        connection.execute("PRAGMA journal_mode=wal")
        connection.commit()
    (folder / "bag.db3-wal").write_bytes(b"something")
    BagReader(folder)
    assert "what is in bag.db3-wal is not read" in caplog.text
