"""One MCAP file of a bag: read by its index or, where that is lost, by its whole chunks.

Files come from cameras that lost power and from strangers: lengths are compared with what there
is before anything is read or made room for, checksums are checked, and a damaged chunk costs its
own messages only.
"""

from __future__ import annotations

import functools
import heapq
import importlib
import io
import logging
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    McapRecord,
    Message,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.records import Stream
from turbseg_ros.bag.schema import canonical_type_name

_LOGGER = logging.getLogger(__name__)

_COMPRESSIONS = ("", "zstd", "lz4")
# Of the messages in a channel; `ros1` is converted.
_ROS_ENCODINGS = ("cdr", "ros1")
_RECORD_HEAD = struct.Struct("<BQ")
_FOOTER_SIZE = _RECORD_HEAD.size + struct.calcsize("<QQI")
# A chunk holds one message at least; 1 GiB is an uncompressed 8K picture five times over.
_MAX_CHUNK = 2**30
# More messages than any recording holds: a count beyond is damage.
MAX_MESSAGES = 2**40
# Bytes that are decompressed at a time, and at most at once.
_PIECE = 2**20
_MAX_AT_ONCE = 2**26
# Later than any time that a file can state.
_NEVER = 2**64
# What the libraries raise on damaged content.
_DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    KeyError,
    OverflowError,
    MemoryError,
    *(RuntimeError, EOFError),  # of lz4
)


class _DamageError(ValueError):
    """Content that can't be; the text says what."""


@dataclass(frozen=True)
class StoredChunk:
    """Where a chunk lies in its file, in bytes, and what it holds.

    `start_ns` and `end_ns` are the times of its first and last message; `channels` are the ids of
    those it has messages of, empty when not known.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]


@dataclass(frozen=True)
class McapFile:
    """What one file holds: channels and schemas by id, messages counted by channel, chunks.

    `content` is where its bytes lie, which is elsewhere when the file had to be unpacked. Without
    `chunks`, messages lie in it one by one. `damage` says what is wrong with the file, None when
    nothing is; counts are then of what is left, and `lossy` tells whether that may be less than
    there was.
    """

    path: Path
    content: Path
    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    counts: Mapping[int, int]
    start_ns: int
    end_ns: int
    chunks: Sequence[StoredChunk]
    damage: str | None = None
    lossy: bool = False

    @property
    def message_count(self) -> int:
        """Messages on all channels."""
        return sum(self.counts.values())

    @functools.cached_property
    def streams(self) -> Mapping[int, Stream]:
        """The channels that hold ROS messages, by id."""
        streams = {id: self._stream(channel) for id, channel in self.channels.items()}
        return {id: stream for id, stream in streams.items() if stream is not None}

    @property
    def left_out(self) -> Sequence[str]:
        """The topics of the other channels, and how they are encoded."""
        return [
            f"{channel.topic} ({channel.message_encoding or 'encoding unknown'}"
            + ("" if channel.schema_id in self.schemas else ", without a type")
            + ")"
            for id, channel in self.channels.items()
            if id not in self.streams
        ]

    def read(self, wanted: Collection[int], since_ns: int = 0) -> Iterator[tuple[int, int, bytes]]:
        """Return channel, time and data of the wanted channels' messages, in the order of time.

        What is damaged is left out with a warning. Memory holds no more than the chunks that
        overlap in time.

        :param since_ns: what was recorded before isn't wanted, and mostly not read.

        :raises OSError: when the file can't be read.
        """
        with self.content.open("rb") as stream:
            messages = (
                _in_order_of_time(self._selected(stream, wanted, since_ns))
                if self.chunks
                else _single_messages(stream, wanted)
            )
            for message in messages:
                if message.log_time < since_ns:
                    continue
                yield message.channel_id, message.log_time, message.data

    def _stream(self, channel: Channel) -> Stream | None:
        schema = self.schemas.get(channel.schema_id)
        if schema is None or channel.message_encoding not in _ROS_ENCODINGS:
            return None
        ros1 = channel.message_encoding == "ros1"
        return Stream(
            topic=channel.topic,
            type_name=canonical_type_name(schema.name),
            message_count=self.counts.get(channel.id, 0),
            qos=channel.metadata.get("offered_qos_profiles", ""),
            ros1_definition=schema.data.decode(errors="replace") if ros1 else None,
        )

    def _selected(
        self, stream: BinaryIO, wanted: Collection[int], since_ns: int
    ) -> Iterator[tuple[int, list[Message]]]:
        """Return the start of each chunk, by time, and its messages on the wanted channels.

        Chunks of which all was recorded before `since_ns` are left out.
        """
        damaged: list[str] = []
        for chunk in sorted(self.chunks, key=lambda chunk: (chunk.start_ns, chunk.offset)):
            if chunk.end_ns < since_ns or (chunk.channels and chunk.channels.isdisjoint(wanted)):
                continue
            try:
                records = _chunk_content(_read_chunk(stream, chunk.offset, chunk.length))
            except _DAMAGE as error:
                damaged.append(f"at byte {chunk.offset}: {_reason(error)}")
                continue
            messages = [record for record in records if isinstance(record, Message)]
            yield chunk.start_ns, [m for m in messages if m.channel_id in wanted]
        if damaged:
            _LOGGER.warning(
                "%s: %d of %d chunks are damaged and their messages lost (the first, %s)",
                self.path,
                len(damaged),
                len(self.chunks),
                damaged[0],
            )


def open_mcap(path: Path, content: Path) -> McapFile:
    """Find out what an MCAP file holds, whose bytes lie in `content`.

    A file that was cut, or whose index is damaged or says too little, is gone through from its
    beginning.

    :raises BagError: when nothing of it can be saved.
    :raises OSError: when it can't be read.
    """
    with content.open("rb") as stream:
        return replace(_opened(path, stream), content=content)


def _opened(path: Path, stream: BinaryIO) -> McapFile:
    size = stream.seek(0, io.SEEK_END)
    stream.seek(max(size - len(MCAP0_MAGIC), len(MCAP0_MAGIC)))
    if stream.read() != MCAP0_MAGIC:
        return _recovered(path, stream, "is truncated")
    try:
        summary = _summary(stream, size)
        return _recovered(path, stream, None) if summary is None else _indexed(path, summary)
    except _DAMAGE as error:
        return _recovered(path, stream, f"has a damaged index ({_reason(error)})")


def _summary(stream: BinaryIO, size: int) -> Summary | None:
    """Read the section at the end that says what a file holds; None when it isn't complete."""
    footer_begin = size - len(MCAP0_MAGIC) - _FOOTER_SIZE
    stream.seek(max(footer_begin, 0))
    footer = Footer.read(_data(stream.read(_FOOTER_SIZE)[_RECORD_HEAD.size :]))
    if not footer.summary_start:
        return None
    if not len(MCAP0_MAGIC) < footer.summary_start <= footer_begin:
        raise _DamageError(f"its summary begins at byte {footer.summary_start}")
    stream.seek(footer.summary_start)
    section = stream.read(size - footer.summary_start)
    # The checksum covers all up to itself.
    checked = section[: footer_begin - footer.summary_start + _FOOTER_SIZE - 4]
    if footer.summary_crc and zlib.crc32(checked) != footer.summary_crc:
        raise _DamageError("its checksum is wrong")
    summary = Summary()
    for record in StreamReader(io.BytesIO(section), skip_magic=True).records:
        if isinstance(record, Statistics):
            summary.statistics = record
        elif isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, Channel):
            summary.channels[record.id] = record
        elif isinstance(record, ChunkIndex):
            summary.chunk_indexes.append(record)
    statistics = summary.statistics
    if statistics is None or len(summary.chunk_indexes) != statistics.chunk_count:
        return None
    return summary if _says_all(summary, statistics) else None


def _says_all(summary: Summary, statistics: Statistics) -> bool:
    """Whether it has all that is optional: counts, and the channels and schemas once more."""
    counted = statistics.channel_message_counts
    if statistics.message_count and not counted:
        return False
    channels = summary.channels
    return counted.keys() <= channels.keys() and all(
        channel.schema_id in summary.schemas or channel.schema_id == 0
        for channel in channels.values()
    )


def _indexed(path: Path, summary: Summary) -> McapFile:
    statistics = summary.statistics
    assert statistics is not None  # asked before
    counts = dict(statistics.channel_message_counts)
    if sum(counts.values()) != statistics.message_count or statistics.message_count > MAX_MESSAGES:
        raise _DamageError("its counts contradict one another")
    if statistics.message_end_time < statistics.message_start_time:
        raise _DamageError("its last message comes before its first")
    compressions = {index.compression for index in summary.chunk_indexes}
    if compressions and compressions.isdisjoint(_COMPRESSIONS):
        raise BagError(
            f"{path} is compressed by {', '.join(map(repr, sorted(compressions)))}; "
            "only zstd and lz4 can be read"
        )
    return McapFile(
        path=path,
        content=path,
        schemas=summary.schemas,
        channels=summary.channels,
        counts=counts,
        start_ns=statistics.message_start_time,
        end_ns=statistics.message_end_time,
        chunks=[
            StoredChunk(
                index.chunk_start_offset,
                index.chunk_length,
                index.message_start_time,
                index.message_end_time,
                frozenset(index.message_index_offsets),
            )
            for index in summary.chunk_indexes
        ],
    )


@dataclass
class _Census:
    """What has been found in a file that is gone through."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    start_ns: int = _NEVER
    end_ns: int = 0
    chunks: list[StoredChunk] = field(default_factory=list)
    # Records that are there but can't be read, and why the first can't.
    damaged: int = 0
    first_fault: str = ""

    def take(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Message):
            self.counts[record.channel_id] += 1
            self.start_ns = min(self.start_ns, record.log_time)
            self.end_ns = max(self.end_ns, record.log_time)

    def take_chunk(self, offset: int, content: bytes) -> None:
        chunk = Chunk.read(_data(content))
        records = _chunk_content(chunk)
        messages = [record for record in records if isinstance(record, Message)]
        for record in records:
            self.take(record)
        self.chunks.append(
            StoredChunk(
                offset,
                _RECORD_HEAD.size + len(content),
                chunk.message_start_time,
                chunk.message_end_time,
                frozenset(message.channel_id for message in messages),
            )
        )


def _recovered(path: Path, stream: BinaryIO, fault: str | None) -> McapFile:
    """Go through a file without an index; `fault` says why it has none, unless none was written.

    :raises BagError: when a faulty file has nothing that is whole.
    """
    census = _Census()
    end = len(MCAP0_MAGIC)
    ended = False
    for raw in _records(stream):
        ended = raw.opcode == Opcode.DATA_END
        try:
            if raw.opcode == Opcode.CHUNK:
                census.take_chunk(raw.begin, raw.content())
            elif raw.opcode in _PLAIN_RECORDS:
                census.take(_PLAIN_RECORDS[raw.opcode](raw.content()))
        except _DAMAGE as error:
            census.damaged += 1
            census.first_fault = census.first_fault or f"at byte {raw.begin}: {_reason(error)}"
        end = raw.end
    lost = 0 if ended else stream.seek(0, io.SEEK_END) - end
    if fault is not None and not census.counts:
        raise BagError(f"{path} {fault}, and nothing of it can be saved: no whole chunk is left")
    known = {id: count for id, count in census.counts.items() if id in census.channels}
    return McapFile(
        path=path,
        content=path,
        schemas=census.schemas,
        channels=census.channels,
        counts=known,
        start_ns=census.start_ns,
        end_ns=census.end_ns,
        chunks=census.chunks,
        damage=_told(fault, census, lost) if fault or not ended or census.damaged else None,
        lossy=bool(not ended or census.damaged),
    )


def _told(fault: str | None, census: _Census, lost: int) -> str:
    found = sum(census.counts.values())
    where = f"its {len(census.chunks)} whole chunks" if census.chunks else "what is whole of it"
    return (
        f"{fault or 'is damaged'}; {found} messages in {where} are read"
        + (f", {lost} bytes behind them are lost" if lost else "")
        + (
            f", {census.damaged} damaged records too ({census.first_fault})"
            if census.damaged
            else ""
        )
    )


@dataclass(frozen=True)
class _RawRecord:
    """A record that is whole, from byte `begin` of its file to before byte `end`."""

    stream: BinaryIO
    begin: int
    end: int
    opcode: int

    def content(self) -> bytes:
        """Read what is behind its head."""
        length = self.end - self.begin - _RECORD_HEAD.size
        if length > _MAX_CHUNK:
            raise _DamageError(f"it is {length} bytes long")
        self.stream.seek(self.begin + _RECORD_HEAD.size)
        return self.stream.read(length)


def _records(stream: BinaryIO) -> Iterator[_RawRecord]:
    """Go through the whole records of a file's data.

    It ends with the data's end, or where a record is longer than the rest of the file.
    """
    size = stream.seek(0, io.SEEK_END)
    offset = len(MCAP0_MAGIC)
    while True:
        stream.seek(offset)
        head = stream.read(_RECORD_HEAD.size)
        if len(head) < _RECORD_HEAD.size:
            return
        opcode, length = _RECORD_HEAD.unpack(head)
        end = offset + _RECORD_HEAD.size + length
        if opcode == 0 or end > size:
            return

        yield _RawRecord(stream, offset, end, opcode)
        if opcode == Opcode.DATA_END:
            return
        offset = end


def _message(content: bytes) -> Message:
    return Message.read(_data(content), len(content))


_PLAIN_RECORDS: Mapping[int, Callable[[bytes], McapRecord]] = {
    Opcode.SCHEMA: lambda content: Schema.read(_data(content)),
    Opcode.CHANNEL: lambda content: Channel.read(_data(content)),
    Opcode.MESSAGE: _message,
}


def _single_messages(stream: BinaryIO, wanted: Collection[int]) -> Iterator[Message]:
    for raw in _records(stream):
        if raw.opcode != Opcode.MESSAGE:
            continue
        try:
            message = _message(raw.content())
        except _DAMAGE:  # told when the file was opened
            continue
        if message.channel_id in wanted:
            yield message


def _in_order_of_time(chunks: Iterator[tuple[int, list[Message]]]) -> Iterator[Message]:
    """Merge chunks that come by their start; equal times stay in the order of the file."""
    waiting: list[tuple[int, int, Message]] = []
    place = 0
    for start_ns, messages in chunks:
        while waiting and waiting[0][0] < start_ns:
            yield heapq.heappop(waiting)[2]
        for message in messages:
            heapq.heappush(waiting, (message.log_time, place, message))
            place += 1
    while waiting:
        yield heapq.heappop(waiting)[2]


def _read_chunk(stream: BinaryIO, offset: int, length: int) -> Chunk:
    if length > _MAX_CHUNK:
        raise _DamageError(f"it is {length} bytes long")
    stream.seek(offset)
    record = stream.read(length)
    if len(record) < _RECORD_HEAD.size or _RECORD_HEAD.unpack_from(record) != (
        Opcode.CHUNK,
        length - _RECORD_HEAD.size,
    ):
        raise _DamageError("there is no such chunk")
    return Chunk.read(_data(record[_RECORD_HEAD.size :]))


def _chunk_content(chunk: Chunk) -> list[McapRecord]:
    """Return the records in a chunk, decompressed to no more than it states and checked."""
    size = chunk.uncompressed_size
    if size > _MAX_CHUNK:
        raise _DamageError(f"it states {size} bytes of content")
    content = _decompressed(chunk)
    if len(content) != size:
        raise _DamageError(f"it has {len(content)} bytes of content, not {size}")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise _DamageError("its checksum is wrong")
    return breakup_chunk(replace(chunk, compression="", data=content))


def _decompressed(chunk: Chunk) -> bytes:
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        return _unpacked_zstd(chunk.data, chunk.uncompressed_size)
    if chunk.compression == "lz4":
        # Of the MCAP library's own dependencies.
        lz4 = importlib.import_module("lz4.frame")
        return _read_in_pieces(lz4.open(io.BytesIO(chunk.data)), chunk.uncompressed_size)
    raise _DamageError(f"it is compressed by {chunk.compression!r}, which is not known")


def _unpacked_zstd(data: bytes, size: int) -> bytes:
    decompressor = zstandard.ZstdDecompressor()
    # Where both lengths agree, it takes one go; what is stated only once may be a lie.
    if size <= _MAX_AT_ONCE and zstandard.frame_content_size(data) == size:
        return decompressor.decompress(data)
    return _read_in_pieces(decompressor.stream_reader(data), size)


def _read_in_pieces(stream: Any, size: int) -> bytes:
    """Read up to a byte more than `size`, taking no more memory than there is content."""
    content = bytearray()
    while len(content) <= size:
        piece = stream.read(min(_PIECE, size + 1 - len(content)))
        if not piece:
            break
        content += piece
    return bytes(content)


def _data(content: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(content))


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
