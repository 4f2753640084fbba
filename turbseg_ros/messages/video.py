"""Video packets in messages, decoded by PyAV where it is installed."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from std_msgs.msg import Header

from turbseg_ros.arrays import Image
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.messages.cdr import (
    CompressedImageView,
    SerialisedDataError,
    compressed_image_view,
    compressed_video_view,
    ffmpeg_packet_view,
)
from turbseg_ros.messages.images import ImageDataError, UnknownEncodingError, stamp_of
from turbseg_ros.segmentation.frame import Frame

_READERS = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": ffmpeg_packet_view,
    "foxglove_msgs/msg/CompressedVideo": compressed_video_view,
    "sensor_msgs/msg/CompressedImage": compressed_image_view,
}
# Types that hold nothing but video, and the transports that publish them.
VIDEO_TRANSPORTS = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "ffmpeg",
    "foxglove_msgs/msg/CompressedVideo": "foxglove",
}
# FFmpeg's decoders by what formats and encoders' names have in them (h264, libx264, hevc_nvenc).
_CODECS = {"264": "h264", "265": "hevc", "hevc": "hevc", "av1": "av1", "vp9": "vp9", "vp8": "vp8"}


def codec_of(image_format: str) -> str | None:
    """Return the decoder for a format such as `h264` or `libx265;yuv420p`, None for pictures."""
    name = image_format.partition(";")[0].lower()
    return next((codec for part, codec in _CODECS.items() if part in name), None)


def video_packet(serialised: memoryview, type_name: str) -> CompressedImageView | None:
    """Return the packet of video that a serialised message holds, None when it is a picture.

    :raises ImageDataError: when it is no message of that type.
    """
    if type_name not in _READERS:
        return None
    try:
        packet = _READERS[type_name](serialised)
    except SerialisedDataError as error:
        raise ImageDataError(f"video {error}") from error
    return packet if type_name in VIDEO_TRANSPORTS or codec_of(packet.format) else None


def how_to_read_video(topic: str, type_name: str) -> str:
    """Return the line that says what to do where PyAV isn't installed."""
    transport = VIDEO_TRANSPORTS.get(type_name, "compressed")
    return (
        f"{topic} holds video packets: '{how_to_install('av')}' to read them as they are, or make "
        "images of them with 'ros2 run image_transport republish --ros-args "
        f"-p in_transport:={transport} -p out_transport:=raw "
        f"-r in/{transport}:={topic} -r out:=/camera/image_raw'"
    )


# Packets that a decoder may hold back at most.
_MAX_DELAY = 256


class VideoDecoder:
    """Decodes the packets of one stream in turn.

    Frames come with the stamp of the packet that holds them, once the decoder has all that they
    are made of: not before the first key frame, and late where a frame refers to later ones.

    :raises ImportError: when PyAV isn't installed.
    """

    def __init__(self) -> None:
        self._av: Any = importlib.import_module("av")
        self._decoder: Any = None
        self._codec: str | None = None
        self._headers: dict[int, Header] = {}
        self._count = 0

    def decode(self, packet: CompressedImageView) -> Iterator[Frame]:
        """Return the frames that are complete with this packet.

        :raises ImageConversionError: when it is damaged, or of a codec that is not known.
        """
        codec = codec_of(packet.format)
        if codec is None:
            raise UnknownEncodingError(
                f"video encoding {packet.format[:40]!r} is not supported; it takes "
                f"{', '.join(sorted(set(_CODECS.values())))}"
            )
        if codec != self._codec:
            yield from self.flush()
            self._decoder = self._av.CodecContext.create(codec, "r")
            self._codec = codec
        content = self._av.Packet(bytes(packet.data))
        content.pts = self._count
        self._headers[self._count] = packet.header
        self._count += 1
        yield from self._decoded(content)

    def flush(self) -> Iterator[Frame]:
        """Return the frames that wait for packets which don't come any more."""
        if self._decoder is not None:
            yield from self._decoded(None)
            self._decoder = None

    def _decoded(self, content: Any) -> Iterator[Frame]:
        try:
            pictures = self._decoder.decode(content)
        except self._av.FFmpegError as error:
            raise ImageDataError(f"video packet can't be decoded: {error}") from error
        for picture in pictures:
            header = self._headers.pop(picture.pts, None)
            if header is not None:
                yield Frame(stamp_of(header), array_of(picture), header.frame_id)
        # What has given no frame by now gives none.
        self._headers.pop(self._count - _MAX_DELAY, None)


def array_of(picture: Any) -> Image:
    """Return a decoded frame of PyAV as HxW (grey) or HxWx3 (BGR), uint8 or uint16 as it is."""
    components = picture.format.components
    deep = max(component.bits for component in components) > 8
    if len(components) == 1:
        # Grey in few bits keeps its values: only the order of bytes changes.
        name = picture.format.name.replace("be", "le") if deep else "gray"
        return np.asarray(picture.to_ndarray(format=name))
    if deep:
        return np.ascontiguousarray(picture.to_ndarray(format="rgb48le")[:, :, ::-1])
    return np.asarray(picture.to_ndarray(format="bgr24"))
