from __future__ import annotations

import resource
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Point
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import Image
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.messages.images import message_from_image

SECOND = 1_000_000_000


def camera_image(seed: int, stamp_ns: int) -> Image:
    pixels = np.random.default_rng(seed).integers(0, 255, (24, 32), np.uint8)
    return message_from_image(pixels, "mono8", stamp_ns, "camera")


def test_another_library_reads_the_same_stamps_types_and_bytes(tmp_path):
    stamps = [5 * SECOND + 7 * i for i in range(4)]
    images = [camera_image(i, stamp) for i, stamp in enumerate(stamps)]
    markers = MarkerArray(markers=[Marker(id=3, text="car", points=[Point(x=1.5)])])
    with BagWriter(tmp_path / "clip") as writer:
        for stamp, image in zip(stamps, images, strict=True):
            writer.write("/camera/image_raw", image, stamp)
        writer.write("/turbseg/centroids", markers, stamps[-1])

    with AnyReader([tmp_path / "clip"]) as reader:
        assert {topic: info.msgtype for topic, info in reader.topics.items()} == {
            "/camera/image_raw": "sensor_msgs/msg/Image",
            "/turbseg/centroids": "visualization_msgs/msg/MarkerArray",
        }
        recorded = list(reader.messages())
        assert [stamp for _, stamp, _ in recorded] == [*stamps, stamps[-1]]
        for (connection, _, cdr), image in zip(recorded[:4], images, strict=True):
            read: Any = reader.deserialize(cdr, connection.msgtype)
            assert (read.encoding, read.header.frame_id) == ("mono8", "camera")
            assert read.data.tobytes() == image.data.tobytes()
        connection, _, cdr = recorded[4]
        found: Any = reader.deserialize(cdr, connection.msgtype)
        marker = found.markers[0]
        assert (marker.id, marker.text, marker.points[0].x) == (3, "car", 1.5)


def test_the_directory_is_as_rosbag2_makes_it(tmp_path):
    with BagWriter(tmp_path / "clip") as writer:
        writer.write("/camera/image_raw", camera_image(0, 0), 2 * SECOND)
        writer.write("/camera/image_raw", camera_image(1, 0), 5 * SECOND)
    assert {path.name for path in tmp_path.rglob("*")} == {"clip", "clip_0.mcap", "metadata.yaml"}
    information = yaml.safe_load((tmp_path / "clip" / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["clip_0.mcap"]
    assert information["message_count"] == 2
    assert information["starting_time"] == {"nanoseconds_since_epoch": 2 * SECOND}
    assert information["duration"] == {"nanoseconds": 3 * SECOND}
    (topic,) = information["topics_with_message_count"]
    assert topic["message_count"] == 2
    assert topic["topic_metadata"]["offered_qos_profiles"][0]["reliability"] == "reliable"


def test_type_hashes_are_those_that_another_library_computes(tmp_path):
    with BagWriter(tmp_path / "clip") as writer:
        writer.write("/image", Image(), 0)
        writer.write("/markers", MarkerArray(), 0)
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([tmp_path / "clip"]) as reader:
        for connection in reader.connections:
            assert connection.digest == typestore.hash_rihs01(connection.msgtype)


def test_qos_is_recorded_in_the_metadata_and_in_the_file(tmp_path):
    qos = QoSProfile(
        depth=3,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )
    with BagWriter(tmp_path / "clip") as writer:
        writer.add_topic("/chatter", "std_msgs/msg/String", qos)
        writer.write("/chatter", String(data="hello"), 1)
    for path in (tmp_path / "clip", tmp_path / "clip" / "clip_0.mcap"):
        with AnyReader([path]) as reader:
            extension: Any = reader.connections[0].ext
            (recorded,) = extension.offered_qos_profiles
        assert recorded.depth == 3
        assert recorded.reliability == QosReliability.BEST_EFFORT
        assert recorded.durability == QosDurability.TRANSIENT_LOCAL


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_nothing_stays_after_an_exception_in_the_middle(tmp_path, error):
    with pytest.raises(error), BagWriter(tmp_path / "clip") as writer:
        for i in range(50):
            writer.write("/camera/image_raw", camera_image(i, i), i)
        raise error
    assert list(tmp_path.iterdir()) == []


def test_the_name_is_taken_only_at_the_end(tmp_path):
    with BagWriter(tmp_path / "deep" / "clip") as writer:
        writer.write("/chatter", String(data="hello"), 1)
        assert not (tmp_path / "deep" / "clip").exists()
    assert (tmp_path / "deep" / "clip").is_dir()


def test_an_existing_output_is_refused_and_kept(tmp_path):
    (tmp_path / "clip").write_text("precious")
    with pytest.raises(BagError, match="clip exists already"), BagWriter(tmp_path / "clip"):
        pass
    assert (tmp_path / "clip").read_text() == "precious"


def test_an_output_that_appears_meanwhile_is_kept(tmp_path):
    with (
        pytest.raises(BagError, match="clip exists already"),
        BagWriter(tmp_path / "clip") as writer,
    ):
        writer.write("/chatter", String(data="hello"), 1)
        (tmp_path / "clip").mkdir()
    assert [path.name for path in tmp_path.rglob("*")] == ["clip"]


@pytest.fixture
def small_files_only():
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_file_that_cannot_grow_is_one_line_and_leaves_nothing(tmp_path, small_files_only):
    noise = np.random.default_rng(0).integers(0, 255, (500, 1000), np.uint8)
    with (
        pytest.raises(BagError, match=r"cannot write .*clip: File too large"),
        BagWriter(tmp_path / "clip") as writer,
    ):
        for i in range(10):
            writer.write("/camera/image_raw", message_from_image(noise, "mono8", 0), i)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("missing", [1, 9, 300, 700, 1500])
def test_a_disk_that_fills_up_at_the_very_end_leaves_nothing(tmp_path, missing):
    def write(name):
        with BagWriter(tmp_path / name) as writer:
            for i in range(20):
                writer.write("/camera/image_raw", camera_image(i, i), i)

    write("whole")
    size = (tmp_path / "whole" / "whole_0.mcap").stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size - missing, hard))
    try:
        with pytest.raises(BagError, match=r"cannot write .*full_: File too large"):
            write("full_")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(BagError, match=r"cannot write .*: Not a directory"),
        BagWriter(tmp_path / "file" / "clip"),
    ):
        pass


def test_a_bag_without_messages_is_a_bag(tmp_path):
    with BagWriter(tmp_path / "clip") as writer:
        writer.add_topic("/chatter", "std_msgs/msg/String")
    with AnyReader([tmp_path / "clip"]) as reader:
        assert reader.message_count == 0
        assert list(reader.topics) == ["/chatter"]


def test_types_that_are_not_installed_are_refused(tmp_path):
    for name in ("no_such_msgs/msg/Thing", "sensor_msgs/msg/NoSuch", "../../etc/passwd"):
        with (
            pytest.raises(BagError, match="is not installed"),
            BagWriter(tmp_path / "clip") as writer,
        ):
            writer.write_serialized("/topic", name, b"", 0)
    assert list(tmp_path.iterdir()) == []


def test_a_topic_carries_one_type_and_no_time_before_the_epoch(tmp_path: Path):
    with BagWriter(tmp_path / "clip") as writer:
        writer.write("/chatter", String(data="hello"), 1)
        with pytest.raises(ValueError, match="carries std_msgs/msg/String"):
            writer.write("/chatter", Image(), 2)
        with pytest.raises(ValueError, match="before the epoch"):
            writer.write_serialized(
                "/chatter", "std_msgs/msg/String", serialize_message(String()), -1
            )
        with pytest.raises(ValueError, match="in the bag already"):
            writer.add_topic("/chatter", "std_msgs/msg/String")
