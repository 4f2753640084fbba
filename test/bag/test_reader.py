from __future__ import annotations

import shutil
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String

from turbseg_ros.bag import mcap_file
from turbseg_ros.bag import qos as qos_format
from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.schema import message_definition
from turbseg_ros.bag.section import Section
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.messages.images import image_from_message, message_from_image

TOPICS = ("/a", "/b", "/c")


def write_strings(path: Path, messages: list[tuple[str, int]]) -> Path:
    """Write (topic, time) pairs, each message holding its place in the list."""
    with BagWriter(path) as writer:
        for place, (topic, stamp_ns) in enumerate(messages):
            writer.write(topic, String(data=str(place)), stamp_ns)
    return path


def write_noise(path: Path, frames: int = 6) -> Path:
    """Write incompressible images, each a chunk of its own."""
    rng = np.random.default_rng(0)
    with BagWriter(path) as writer:
        for i in range(frames):
            noise = rng.integers(0, 255, (1050, 1000), np.uint8)
            writer.write("/camera/image_raw", message_from_image(noise, "mono8", i), i)
    return path


def refusal(path: Path) -> str:
    """Read all of a bag that must be refused; return the complaint, which must be one line."""
    with pytest.raises(BagError) as caught:
        list(BagReader(path).messages())
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)
    return str(caught.value)


@settings(deadline=None, max_examples=50)
@given(
    messages=st.lists(st.tuples(st.sampled_from(TOPICS), st.integers(0, 50)), max_size=30),
    asked=st.none() | st.sets(st.sampled_from(TOPICS)),
)
def test_messages_come_in_order_of_time_and_only_those_asked_for(messages, asked):
    with tempfile.TemporaryDirectory() as folder:
        reader = BagReader(write_strings(Path(folder) / "bag", messages))
        read = [
            (record.topic, record.stamp_ns, int(record.message().data))
            for record in reader.messages(asked)
        ]
        counts = {name: topic.message_count for name, topic in reader.topics.items()}
    numbered = [(topic, stamp, place) for place, (topic, stamp) in enumerate(messages)]
    wanted = [item for item in numbered if asked is None or item[0] in asked]
    assert read == sorted(wanted, key=lambda item: item[1])
    assert counts == {
        topic: sum(topic == t for t, _ in messages) for topic in {t for t, _ in messages}
    }


@settings(deadline=None, max_examples=50)
@given(
    times=st.lists(st.integers(0, 50), min_size=1, max_size=30),
    start=st.integers(0, 60),
    duration=st.none() | st.integers(1, 60),
)
def test_a_section_has_what_was_recorded_in_it(times, start, duration):
    section = Section(start * 1e-9, None if duration is None else duration * 1e-9)
    with tempfile.TemporaryDirectory() as folder:
        path = write_strings(Path(folder) / "bag", [("/a", time) for time in times])
        first = min(times) + start
        wanted = sorted(
            time
            for time in times
            if first <= time and (duration is None or time < first + duration)
        )
        if first > max(times):
            with pytest.raises(BagError, match="has nothing from"):
                BagReader(path, section)
            return
        reader = BagReader(path, section)
        assert [record.stamp_ns for record in reader.messages()] == wanted
        assert 1 <= reader.topics["/a"].message_count <= len(times)
        assert reader.duration_ns <= max(times) - first


def test_a_section_leaves_chunks_before_it_unread(tmp_path, monkeypatch):
    path = write_noise(tmp_path / "bag", frames=12)
    read = []
    whole = mcap_file._read_chunk
    monkeypatch.setattr(
        mcap_file, "_read_chunk", lambda *where: read.append(where) or whole(*where)
    )
    stamps = [record.stamp_ns for record in BagReader(path, Section(8e-9, 3e-9)).messages()]
    assert stamps == [8, 9, 10]
    assert len(read) <= 4


def test_images_come_back_as_they_were_written(tmp_path):
    image = np.arange(48, dtype=np.uint16).reshape(6, 8)
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/thermal", message_from_image(image, "mono16", 7, "camera"), 9)
    (record,) = BagReader(tmp_path / "bag").messages()
    assert (record.topic, record.type_name, record.stamp_ns) == (
        "/thermal",
        "sensor_msgs/msg/Image",
        9,
    )
    np.testing.assert_array_equal(image_from_message(record.message()), image)


@pytest.mark.parametrize("version", [8, 9])
def test_a_bag_from_another_library_is_read(tmp_path, version):
    typestore = get_typestore(Stores.ROS2_JAZZY)
    kind = typestore.types["std_msgs/msg/String"]
    with RosbagsWriter(
        tmp_path / "bag", version=version, storage_plugin=StoragePlugin.MCAP
    ) as writer:
        connection = writer.add_connection("/chatter", kind.__msgtype__, typestore=typestore)
        for i in range(3):
            cdr = typestore.serialize_cdr(kind(data=f"word {i}"), kind.__msgtype__)
            writer.write(connection, 100 + i, cdr)
    read = [
        (record.stamp_ns, record.message().data)
        for record in BagReader(tmp_path / "bag").messages()
    ]
    assert read == [(100, "word 0"), (101, "word 1"), (102, "word 2")]


def test_a_bag_of_several_files_is_one(tmp_path):
    first = write_strings(tmp_path / "first", [("/a", 1), ("/a", 5), ("/b", 8)])
    second = write_strings(tmp_path / "second", [("/a", 7), ("/c", 9)])
    shutil.copy(second / "second_0.mcap", first / "first_1.mcap")
    metadata = yaml.safe_load((first / "metadata.yaml").read_text())
    files = ["first_0.mcap", "first_1.mcap"]
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = files
    (first / "metadata.yaml").write_text(yaml.safe_dump(metadata))

    reader = BagReader(first)
    assert {name: topic.message_count for name, topic in reader.topics.items()} == {
        "/a": 3,
        "/b": 1,
        "/c": 1,
    }
    assert [record.stamp_ns for record in reader.messages()] == [1, 5, 7, 8, 9]
    assert reader.duration_ns == 8


def test_a_single_file_and_a_directory_without_metadata_are_read(tmp_path):
    bag = write_strings(tmp_path / "bag", [("/a", 1), ("/a", 2)])
    (bag / "metadata.yaml").unlink()
    for path in (bag, bag / "bag_0.mcap"):
        assert [record.stamp_ns for record in BagReader(path).messages()] == [1, 2]


def test_recorded_qos_is_read(tmp_path):
    qos = QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/a", "std_msgs/msg/String", qos)
    assert BagReader(tmp_path / "bag").topics["/a"].qos == (qos,)


def test_qos_written_before_jazzy_in_numbers_is_read():
    (profile,) = qos_format.from_yaml(
        """\
        - history: 3
          depth: 0
          reliability: 2
          durability: 2
          deadline: {sec: 9223372036, nsec: 854775807}
          lifespan: {sec: 2147483651, nsec: 294967295}
          liveliness: 1
          liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
          avoid_ros_namespace_conventions: false
        """
    )
    assert profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert profile.durability == DurabilityPolicy.VOLATILE
    assert profile.liveliness == LivelinessPolicy.AUTOMATIC


def test_memory_holds_a_few_chunks_however_long_the_bag(tmp_path):
    reader = BagReader(write_noise(tmp_path / "bag", frames=24))
    tracemalloc.start()
    try:
        assert sum(len(record.data) for record in reader.messages()) > 24 * 1_050_000
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * 1_050_000


def test_a_file_without_chunks_is_read(tmp_path):
    with (tmp_path / "plain.mcap").open("wb") as stream:
        writer = McapWriter(stream, use_chunking=False)
        writer.start(profile="ros2", library="")
        schema = writer.register_schema(
            "std_msgs/msg/String",
            "ros2msg",
            message_definition("std_msgs/msg/String").text.encode(),
        )
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_message(channel, 3, b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00", 3)
        writer.finish()
    (record,) = BagReader(tmp_path / "plain.mcap").messages()
    assert (record.stamp_ns, record.message().data) == (3, "hi")


@settings(deadline=None, max_examples=150)
@given(data=st.data())
def test_a_flipped_byte_is_refused_in_one_line_or_does_no_harm(flippable_bag, data):
    place = data.draw(st.integers(8, len(flippable_bag) - 9))
    flip = data.draw(st.integers(1, 255))
    content = bytearray(flippable_bag)
    content[place] ^= flip
    with tempfile.NamedTemporaryFile(suffix=".mcap") as file:
        file.write(content)
        file.flush()
        try:
            for record in BagReader(Path(file.name)).messages():
                record.message()
        except BagError as error:
            assert "\n" not in str(error)


@pytest.fixture(scope="module")
def flippable_bag(tmp_path_factory) -> bytes:
    bag = write_strings(tmp_path_factory.mktemp("flip") / "bag", [("/a", 1), ("/b", 2)])
    return (bag / "bag_0.mcap").read_bytes()


def test_what_is_no_bag_is_named(tmp_path):
    assert "no such bag" in refusal(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    assert "no metadata.yaml and no .mcap files" in refusal(tmp_path / "empty")
    (tmp_path / "notes.txt").write_text("not a bag at all")
    assert "neither an MCAP file nor a rosbag2 directory" in refusal(tmp_path / "notes.txt")
    (tmp_path / "nothing.mcap").touch()
    assert "neither an MCAP file" in refusal(tmp_path / "nothing.mcap")


def test_several_files_without_metadata_are_not_guessed_at(tmp_path):
    bag = write_strings(tmp_path / "bag", [("/a", 1)])
    for name in ("other_1.mcap", "other.mcap"):
        shutil.copy(bag / "bag_0.mcap", bag / name)
        (bag / "metadata.yaml").unlink(missing_ok=True)
        assert "no metadata.yaml and 2 .mcap files" in refusal(bag)
        (bag / name).unlink()


def test_a_file_that_metadata_names_and_is_missing_is_named(tmp_path):
    bag = write_strings(tmp_path / "bag", [("/a", 1)])
    (bag / "bag_0.mcap").unlink()
    assert "lacks bag_0.mcap" in refusal(bag)


def test_damaged_metadata_is_named(tmp_path):
    bag = write_strings(tmp_path / "bag", [("/a", 1)])
    stored = "rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: "
    for content in ("{", "[]", "rosbag2_bagfile_information: 3", "\x00", stored + "5}"):
        (bag / "metadata.yaml").write_text(content)
        assert "metadata.yaml" in refusal(bag)
    for names in ("[5]", "[[a]]", "[]", "{}"):
        (bag / "metadata.yaml").write_text(stored + names + "}")
        assert "names no .mcap file" in refusal(bag)


def test_a_message_of_a_type_not_installed_is_named(tmp_path):
    with (tmp_path / "odd.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2", library="")
        schema = writer.register_schema("odd_msgs/msg/Odd", "ros2msg", b"int8 x\n")
        channel = writer.register_channel("/odd", "cdr", schema)
        writer.add_message(channel, 1, b"\x00\x01\x00\x00\x01", 1)
        writer.finish()
    (record,) = BagReader(tmp_path / "odd.mcap").messages()
    with pytest.raises(BagError, match="odd_msgs/msg/Odd is not installed"):
        record.message()


def image_bag(path: Path, *topics: str) -> BagReader:
    with BagWriter(path) as writer:
        for topic in topics:
            message = CompressedImage() if topic.endswith("compressed") else Image()
            writer.write(topic, message, 1)
        writer.write("/chatter", String(), 1)
        writer.add_topic("/silent_camera", "sensor_msgs/msg/Image")
    return BagReader(path)


@pytest.mark.parametrize("topic", ["/camera/image_raw", "/camera/image_raw/compressed"])
def test_the_only_image_topic_is_found(tmp_path, topic):
    assert image_bag(tmp_path / "bag", topic, "/ground_truth/labels").find_image_topic() == topic


def test_a_requested_image_topic_is_taken(tmp_path):
    reader = image_bag(tmp_path / "bag", "/left", "/right")
    assert reader.find_image_topic("/right") == "/right"
    with pytest.raises(BagError, match=r"no images on /chatter.* images on /left, /right"):
        reader.find_image_topic("/chatter")
    with pytest.raises(BagError, match=r"no images on /missing"):
        reader.find_image_topic("/missing")


def test_several_image_topics_are_named(tmp_path):
    with pytest.raises(BagError, match="--image-topic: /left, /right"):
        image_bag(tmp_path / "bag", "/left", "/right").find_image_topic()


def test_no_image_topic_names_what_there_is(tmp_path):
    with pytest.raises(BagError, match=r"no image topic to segment; its topics: .*/chatter"):
        image_bag(tmp_path / "bag", "/ground_truth/labels").find_image_topic()
