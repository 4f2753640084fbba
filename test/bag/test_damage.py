"""Bags that were cut, damaged or made to harm: what is whole is read, the rest is told."""

from __future__ import annotations

import itertools
import logging
import os
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from sensor_msgs.msg import Image
from std_msgs.msg import String

from turbseg_ros.bag import mcap_file
from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.schema import message_class, message_definition
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.messages.images import message_from_image

IMAGES = "/camera/image_raw"
CHUNKS = 6
NOBODY = 65534


@pytest.fixture(scope="module")
def sound_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of incompressible images, each a chunk of its own, stamped 0, 1, 2..."""
    path = tmp_path_factory.mktemp("sound") / "bag"
    random = np.random.default_rng(0)
    with BagWriter(path) as writer:
        for stamp in range(CHUNKS):
            noise = random.integers(0, 255, (1050, 1000), np.uint8)
            writer.write(IMAGES, message_from_image(noise, "mono8", stamp), stamp)
    return path


@pytest.fixture
def bag(sound_bag: Path, tmp_path: Path) -> Path:
    return shutil.copytree(sound_bag, tmp_path / "bag")


def content_of(bag: Path) -> bytearray:
    return bytearray((bag / "bag_0.mcap").read_bytes())


def put(bag: Path, content: bytes | bytearray, *, metadata: bool = True) -> Path:
    (bag / "bag_0.mcap").write_bytes(content)
    if not metadata:
        (bag / "metadata.yaml").unlink()
    return bag


def stamps(path: Path) -> list[int]:
    return [record.stamp_ns for record in BagReader(path).messages()]


def chunk_places(content: bytes | bytearray) -> list[tuple[int, int]]:
    """Find the chunks: first byte, and the byte behind the last."""
    places, offset = [], 8
    while offset < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, offset)
        if opcode == 6:
            places.append((offset, offset + 9 + length))
        offset += 9 + length
    return places


@pytest.mark.parametrize("tenths", range(10))
@pytest.mark.parametrize("metadata", [True, False])
def test_whole_chunks_of_a_cut_bag_are_read_and_the_loss_is_told(
    bag: Path, tenths: int, metadata: bool, caplog: pytest.LogCaptureFixture
) -> None:
    content = content_of(bag)
    length = len(content) * tenths // 10
    whole = sum(end <= length for _, end in chunk_places(content))
    put(bag, content[:length], metadata=metadata)
    if whole == 0:
        with pytest.raises(
            BagError, match=r"truncated, and nothing|neither an MCAP file"
        ) as error:
            BagReader(bag)
        assert "\n" not in str(error.value)
        return
    assert stamps(bag) == list(range(whole))
    assert f"is truncated; {whole} messages in its {whole} whole chunks are read" in caplog.text
    told = f"{CHUNKS - whole} messages of {CHUNKS} are lost" if metadata else "is not recorded"
    assert told in caplog.text


def test_of_a_bag_that_lacks_its_index_only_nothing_is_lost(
    bag: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for cut in (1, 8, 60):
        assert stamps(put(bag, content_of(bag)[:-cut])) == list(range(CHUNKS))
    assert "lost" not in caplog.text


def test_a_damaged_chunk_costs_its_own_messages(
    bag: Path, caplog: pytest.LogCaptureFixture
) -> None:
    content = content_of(bag)
    begin, end = chunk_places(content)[2]
    content[(begin + end) // 2] ^= 0xFF
    assert stamps(put(bag, content)) == [0, 1, 3, 4, 5]
    assert "1 of 6 chunks are damaged and their messages lost" in caplog.text


def test_a_damaged_index_is_done_without(bag: Path, caplog: pytest.LogCaptureFixture) -> None:
    content = content_of(bag)
    content[-30] ^= 0xFF  # where the summary begins
    assert stamps(put(bag, content)) == list(range(CHUNKS))
    assert "has a damaged index" in caplog.text


def test_an_index_whose_last_message_comes_before_its_first_is_done_without(
    bag: Path, caplog: pytest.LogCaptureFixture
) -> None:
    content = content_of(bag)
    # Statistics, opcode 11: six counts of 26 bytes in all, then the first and the last time.
    (offset,) = struct.unpack_from("<Q", content, len(content) - 28)
    while content[offset] != 11:
        offset += 9 + struct.unpack_from("<Q", content, offset + 1)[0]
    first, last = struct.unpack_from("<QQ", content, offset + 35)
    struct.pack_into("<QQ", content, offset + 35, last, first)
    content[-12:-8] = bytes(4)  # no checksum
    reader = BagReader(put(bag, content))
    assert reader.duration_ns == last - first == CHUNKS - 1
    assert "has a damaged index" in caplog.text


@pytest.mark.parametrize("index_types", [IndexType.NONE, IndexType.ALL])
@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_every_layout_is_read_whole_and_cut(
    tmp_path: Path, index_types: IndexType, compression: CompressionType, chunked: bool
) -> None:
    file = tmp_path / "plain.mcap"
    write_mcap(
        file,
        chunk_size=100,
        index_types=index_types,
        compression=compression,
        use_chunking=chunked,
    )
    assert stamps(file) == list(range(50))
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    read = stamps(file)
    assert 5 < len(read) < 50
    assert read == list(range(len(read)))


def write_mcap(file: Path, kind: str = "std_msgs/msg/String", **options: Any) -> None:
    """Write 50 messages, some bytes each."""
    with file.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start(profile="ros2", library="")
        schema = writer.register_schema(kind, "ros2msg", b"string data")
        channel = writer.register_channel("/a", "cdr", schema)
        for stamp in range(50):
            writer.add_message(channel, stamp, b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00", stamp)
        writer.finish()


def with_chunk(file: Path, compression: str, data: bytes, size: int) -> Path:
    """Replace the only chunk of a file by one that states `size` bytes of content; no index."""
    write_mcap(file)
    content = file.read_bytes()
    ((begin, end),) = chunk_places(content)
    name = compression.encode()
    body = struct.pack("<QQQI", 0, 50, size, 0) + struct.pack("<I", len(name)) + name
    body += struct.pack("<Q", len(data)) + data
    record = struct.pack("<BQ", 6, len(body)) + body
    file.write_bytes(content[:begin] + record + content[end:])
    return file


BOMB = bytes(64 << 20)
# Nothing in it says how much it is.
STREAMED = zstandard.ZstdCompressor(write_content_size=False).compress(b"little")
BOMBS = {
    "little zstd that states much": ("zstd", STREAMED, 2**29),
    "little lz4 that states much": ("lz4", lz4.frame.compress(b"little"), 2**29),
    "zstd that states more than it may": ("zstd", zstandard.compress(BOMB), 2**40),
    "zstd that states less than it is": ("zstd", zstandard.compress(BOMB), 100),
    "lz4 that states less than it is": ("lz4", lz4.frame.compress(BOMB), 100),
    "zstd that is cut": ("zstd", zstandard.compress(BOMB[:9999])[:15], 9999),
    "lz4 that is cut": ("lz4", lz4.frame.compress(BOMB[:9999])[:15], 9999),
    "no zstd": ("zstd", b"nothing of the kind", 100),
    "no lz4": ("lz4", b"nothing of the kind", 100),
    "plain that states more": ("", b"abc", 2**63),
    "unknown compression": ("bz2", b"abc", 3),
}


@pytest.mark.parametrize(("compression", "data", "size"), BOMBS.values(), ids=BOMBS.keys())
def test_a_chunk_that_lies_about_its_content_is_refused_before_memory_is_taken(
    tmp_path: Path, compression: str, data: bytes, size: int
) -> None:
    file = with_chunk(tmp_path / "bomb.mcap", compression, data, size)
    tracemalloc.start()
    try:
        with pytest.raises(BagError, match="nothing of it can be saved"):
            list(BagReader(file).messages())
        assert tracemalloc.get_traced_memory()[1] < 8e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("offset", [9, 33, 40, 60])
@pytest.mark.parametrize("size", [2**31, 2**40, 2**63, 2**64 - 1])
def test_a_length_beyond_the_file_is_not_believed(bag: Path, offset: int, size: int) -> None:
    content = content_of(bag)
    begin, _ = chunk_places(content)[1]
    struct.pack_into("<Q", content, begin + offset - 8, size)
    for cut in (0, 8):
        read = stamps(put(bag, content[: len(content) - cut]))
        assert read[0] == 0
        assert 1 not in read


@settings(deadline=None, max_examples=200)
@given(data=st.data())
def test_flipped_and_missing_bytes_cost_messages_at_most(
    small_file: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray(small_file[: data.draw(st.integers(0, len(small_file)))])
    for _ in range(data.draw(st.integers(0, 4))):
        if content:
            content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    file = tmp_path_factory.mktemp("flip") / "flipped.mcap"
    file.write_bytes(content)
    try:
        reader = BagReader(file)
        for record in reader.messages():
            assert record.topic in reader.topics
            record.message()
    except BagError as error:
        assert "\n" not in str(error)


@pytest.fixture(scope="module")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("small") / "bag"
    with BagWriter(path) as writer:
        for stamp in range(5):
            writer.write("/a", String(data=str(stamp)), stamp)
            writer.write("/b", Image(), stamp)
    return (path / "bag_0.mcap").read_bytes()


def test_a_split_recording_that_was_killed_is_read_in_order(
    sound_bag: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for number, name in enumerate(["day_0.mcap", "day_1.mcap"]):
        with BagWriter(tmp_path / str(number)) as writer:
            writer.write("/a", String(data=name), number)
        shutil.move(tmp_path / str(number) / f"{number}_0.mcap", tmp_path / name)
        shutil.rmtree(tmp_path / str(number))
    shutil.copy(sound_bag / "bag_0.mcap", tmp_path / "day_2.mcap")
    os.truncate(tmp_path / "day_2.mcap", 3_000_000)
    reader = BagReader(tmp_path)
    assert {name: topic.message_count for name, topic in reader.topics.items()} == {
        "/a": 2,
        IMAGES: 2,
    }
    assert len(list(reader.messages())) == 4
    assert "day_2.mcap is truncated" in caplog.text


WRITE_FOR_EVER = """
import itertools, sys
import numpy as np
from pathlib import Path
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.messages.images import message_from_image
random = np.random.default_rng(0)
with BagWriter(Path(sys.argv[1])) as writer:
    for stamp in itertools.count():
        noise = random.integers(0, 255, (500, 700), np.uint8)
        writer.write("/camera/image_raw", message_from_image(noise, "mono8", stamp), stamp)
        print(stamp, flush=True)
"""


def test_what_was_written_before_a_kill_is_read_back(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITE_FOR_EVER, str(tmp_path / "bag")],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        written = next(int(line) for line in process.stdout if int(line) >= 40)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait(10)
        process.stdout.close()
    # Under its name there is nothing; what there is says that it is partial.
    assert not (tmp_path / "bag").exists()
    (partial,) = tmp_path.iterdir()
    assert partial.name.endswith(".partial")
    read = stamps(partial)
    assert read == list(range(len(read)))
    # A chunk takes three of these; it and the one before it may not have reached the disk.
    assert len(read) >= written - 6


@pytest.fixture
def nobodys_folder() -> Iterator[Path]:
    """A folder of this process's user, who is nobody when the tests run as root."""
    user = os.geteuid()
    with tempfile.TemporaryDirectory() as name:
        if user == 0:
            os.chown(name, NOBODY, NOBODY)
            os.seteuid(NOBODY)
        try:
            yield Path(name)
        finally:
            os.seteuid(user)


def test_a_bag_or_a_place_without_permission_is_one_line(nobodys_folder: Path) -> None:
    bag = nobodys_folder / "bag"
    with BagWriter(bag) as writer:
        writer.write("/a", String(data="hello"), 1)
    for path in (bag / "bag_0.mcap", bag / "metadata.yaml", bag):
        mode = path.stat().st_mode
        path.chmod(0)
        with pytest.raises(BagError, match="Permission denied") as error:
            list(BagReader(bag).messages())
        assert "\n" not in str(error.value)
        path.chmod(mode)
    bag.chmod(0o500)
    with pytest.raises(BagError, match="Permission denied"), BagWriter(bag / "out"):
        pass
    bag.chmod(0o700)


# --- Made to harm -------------------------------------------------------------------------------


def aliases(letters: str = "abcdefgh") -> str:
    """YAML in which each line is nine times the one before: 43 million words."""
    lines = [f"{letters[0]}: &{letters[0]} [x, x, x, x, x, x, x, x, x]"]
    for before, letter in itertools.pairwise(letters):
        lines.append(f"{letter}: &{letter} [{', '.join([f'*{before}'] * 9)}]")
    return "\n".join(lines) + "\n"


STORED = "rosbag2_bagfile_information: {storage_identifier: "
HARMFUL = {
    "nested": "[" * 20_000,
    "storage": aliases() + STORED + "*h}",
    "compression": aliases() + STORED + "mcap, compression_mode: *h}",
    "names": aliases() + STORED + "mcap, relative_file_paths: [*h]}",
    "python": '!!python/object/apply:os.system ["false"]',
    "outside": STORED + "mcap, relative_file_paths: ['../../outside.mcap', /etc/passwd, '..']}",
}


@pytest.mark.timeout(100)
@pytest.mark.parametrize("metadata", HARMFUL.values(), ids=HARMFUL.keys())
def test_harmful_metadata_is_refused_in_one_short_line(bag: Path, metadata: str) -> None:
    shutil.copy(bag / "bag_0.mcap", bag.parent.parent / "outside.mcap")
    (bag / "metadata.yaml").write_text(metadata)
    with pytest.raises(BagError) as error:
        BagReader(bag)
    assert len(str(error.value)) < 1100
    assert "\n" not in str(error.value)


def test_counts_in_the_metadata_are_not_trusted_further_than_they_go(bag: Path) -> None:
    metadata = yaml.safe_load((bag / "metadata.yaml").read_text())
    topics = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
    content = content_of(bag)
    put(bag, content[: len(content) // 2])
    for count in (-5, "many", None, [], 1e400, 2**70):
        topics[0]["message_count"] = count
        (bag / "metadata.yaml").write_text(yaml.safe_dump(metadata))
        reader = BagReader(bag)
        assert reader.topics[IMAGES].message_count == 3
        assert len(list(reader.messages())) == 3


@pytest.mark.parametrize(
    "kind",
    [
        "antigravity/msg/X",
        "os/msg/System",
        "../../x/msg/Y",
        "std_msgs/msg/__class__",
        "x\x1b[2J/msg/Y",
    ],
)
def test_a_type_name_imports_nothing_but_messages(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "antigravity").mkdir()
    (tmp_path / "antigravity" / "__init__.py").write_text("raise SystemExit('imported')")
    monkeypatch.syspath_prepend(tmp_path)
    write_mcap(tmp_path / "odd.mcap", kind)
    record = next(BagReader(tmp_path / "odd.mcap").messages())
    for ask in (record.message, lambda: message_class(kind), lambda: message_definition(kind)):
        with pytest.raises(BagError, match="is not installed") as error:
            ask()
        assert str(error.value).isprintable()
    assert "antigravity" not in sys.modules


@pytest.mark.parametrize(
    "text",
    [
        "- {history: keep_last, depth: -1, reliability: 1, durability: 1, deadline: 3}",
        "- {history: never, depth: .inf}",
        "- " + "[" * 10_000,
        "- history: keep_last\n  depth: 1e400",
        "- {history: 1, depth: 1, reliability: 1, durability: 1, liveliness: 1,"
        # A word a thousand million times.
        " deadline: {sec: word, nsec: 0}, lifespan: {sec: 0, nsec: 0}}",
        "- {history: 1, depth: 99999999999999, reliability: 1, durability: 1, liveliness: 1,"
        " deadline: {sec: 1, nsec: 0}, lifespan: {sec: 1, nsec: 0},"
        " liveliness_lease_duration: {sec: 1, nsec: 0}}",
        "just words",
        "{",
    ],
    ids=lambda text: text[:30],
)
def test_odd_qos_does_not_keep_a_bag_from_being_read(
    tmp_path: Path, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    with (tmp_path / "odd.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2", library="")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": text})
        writer.add_message(channel, 1, b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00", 1)
        writer.finish()
    reader = BagReader(tmp_path / "odd.mcap")
    assert reader.topics["/a"].qos == ()
    assert [record.message().data for record in reader.messages()] == ["hi"]
    assert "QoS profiles that can't be read" in caplog.text


def test_a_name_from_a_bag_does_not_speak_to_the_terminal() -> None:
    error = BagError(f"no topic \x1b]0;owned\x07{'x' * 5000}\nand more")
    assert str(error).isprintable()
    assert len(str(error)) < 1100


def test_damage_is_warned_of_once_a_pass(
    bag: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = content_of(bag)
    for begin, end in chunk_places(content):
        content[(begin + end) // 2] ^= 0xFF
    assert stamps(put(bag, content)) == []
    warnings = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert len(warnings) == 1
    assert mcap_file.__name__ == warnings[0].name
