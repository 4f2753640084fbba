"""Clips as thermal cameras and phones give them: bits, pages and times as they are, or a line."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.import_ import main
from turbseg_ros.datasets.video import VideoFile, open_video
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.messages.images import image_from_message

SHAPE = (48, 64)
IMAGES, TRUTH = "/camera/image_raw", "/ground_truth/labels"


def deep_frames(count: int, bits: int = 16) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    return [random.integers(0, 2**bits, SHAPE, np.uint16) for _ in range(count)]


def numbered(count: int) -> list[np.ndarray]:
    """Frames that say by their grey value which they are."""
    return [np.full(SHAPE, 10 + number, np.uint8) for number in range(count)]


def imported(
    source: Path, bag: Path, *options: str
) -> tuple[list[float], list[np.ndarray], set[str]]:
    """Import a clip; return times in seconds from the first, images and encodings."""
    assert main([str(source), str(bag), *options]) == 0
    records = list(BagReader(bag).messages([IMAGES]))
    messages = [record.message() for record in records]
    times = [(record.stamp_ns - records[0].stamp_ns) * 1e-9 for record in records]
    return times, [image_from_message(m) for m in messages], {m.encoding for m in messages}


# --- Video ---------------------------------------------------------------------------------------


def write_video(
    path: Path,
    frames: Sequence[np.ndarray],
    pixels: str,
    codec: str = "ffv1",
    milliseconds: Sequence[int] | None = None,
    given: str | None = None,
) -> Path:
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pixels
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(image, format=given or pixels)
            frame.pts = milliseconds[number] if milliseconds else 40 * number
            frame.time_base = Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_thermal_video(path: Path, frames: Sequence[np.ndarray]) -> Path:
    """Write 16-bit grey by OpenCV alone."""
    options = [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U, cv2.VIDEOWRITER_PROP_IS_COLOR, 0]
    codec = cv2.VideoWriter.fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, 30, SHAPE[::-1], options)
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no 16-bit video")
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


@pytest.mark.parametrize("suffix", [".mkv", ".avi"])
def test_grey_of_16_bits_is_kept_without_pyav(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    frames = deep_frames(4)
    monkeypatch.setitem(sys.modules, "av", None)
    video = write_thermal_video(tmp_path / f"thermal{suffix}", frames)
    times, images, encodings = imported(video, tmp_path / "bag")
    assert encodings == {"mono16"}
    np.testing.assert_array_equal(images, frames)
    np.testing.assert_allclose(times, np.arange(4) / 30, atol=1e-9)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("pixels", "bits"),
    [("gray10le", 10), ("gray12le", 12), ("gray16le", 16)],
)
def test_grey_of_more_than_8_bits_keeps_its_values(
    tmp_path: Path, pixels: str, bits: int, capsys: pytest.CaptureFixture
) -> None:
    frames = deep_frames(4, bits)
    video = write_video(tmp_path / "deep.mkv", frames, pixels)
    assert open_video(video).depth == bits
    _, images, encodings = imported(video, tmp_path / "bag")
    assert encodings == {"mono16"}
    np.testing.assert_array_equal(images, frames)
    assert capsys.readouterr().err == ""


def test_colour_of_16_bits_is_kept(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    frames = [random.integers(0, 65535, (*SHAPE, 3), np.uint16) for _ in range(3)]
    video = write_video(tmp_path / "deep.mkv", frames, "gbrp16le", given="rgb48le")
    _, images, encodings = imported(video, tmp_path / "bag")
    assert encodings == {"bgr16"}
    np.testing.assert_array_equal(images, [frame[:, :, ::-1] for frame in frames])


@pytest.mark.parametrize("pixels", ["gray10le", "gray12le"])
def test_what_opencv_cuts_to_8_bits_is_said_without_pyav(
    tmp_path: Path, pixels: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    bits = int(pixels[4:6])
    video = write_video(tmp_path / "deep.mkv", deep_frames(4, bits), pixels)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    _, _, encodings = imported(video, tmp_path / "bag")
    assert encodings == {"mono8"}
    said = capsys.readouterr().err
    assert f"deep.mkv: {bits} bits a channel become 8; '{how_to_install('av')}'" in said
    assert said.count("\n") == 1


MILLISECONDS = [0, 40, 80, 1080, 1120, 1127, 2400]


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "given"),
    [
        ("vfr.mkv", "ffv1", "gray", "gray"),
        ("vfr.mp4", "libx264", "yuv420p", "gray"),
        ("deep.mkv", "ffv1", "gray12le", "gray"),
    ],
)
def test_a_variable_frame_rate_keeps_its_stamps(
    tmp_path: Path, name: str, codec: str, pixels: str, given: str, capsys: pytest.CaptureFixture
) -> None:
    frames = numbered(len(MILLISECONDS))
    video = write_video(tmp_path / name, frames, pixels, codec, MILLISECONDS, given)
    times, images, _ = imported(video, tmp_path / "bag")
    assert len(images) == len(frames)
    np.testing.assert_allclose(times, np.array(MILLISECONDS) / 1000, atol=2e-3)
    out, err = capsys.readouterr()
    assert "7 frames in 2.40 s, as in the source: 7 to 1273 ms apart" in out
    assert err == ""


def test_a_rate_that_is_asked_for_spaces_a_video_evenly(tmp_path: Path) -> None:
    video = write_video(tmp_path / "vfr.mkv", numbered(7), "gray", milliseconds=MILLISECONDS)
    times, _, _ = imported(video, tmp_path / "bag", "--rate", "10")
    np.testing.assert_allclose(times, np.arange(7) / 10, atol=1e-9)


@pytest.mark.parametrize("rate", [24000 / 1001, 29.97, 30.0, 59.94, 240.0])
def test_stamps_in_whole_milliseconds_stand_for_even_ones(
    monkeypatch: pytest.MonkeyPatch, rate: float
) -> None:
    stamps = [round(1000 * number / rate) / 1000 for number in range(500)]
    times = timed(stamps, rate, monkeypatch)
    np.testing.assert_allclose(times, np.arange(500) / rate, atol=1e-9)


def timed(stamps: Sequence[float], rate: float, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    image = np.zeros(SHAPE, np.uint8)
    monkeypatch.setattr(VideoFile, "_decoded", lambda self: ((stamp, image) for stamp in stamps))
    video = VideoFile(Path("clip.mkv"), rate, len(stamps))
    return [time for time, _ in video.timed(rate, as_asked=False)]


@pytest.mark.parametrize(
    "stamps",
    [[0.0] * 5, [float("nan")] * 5, [3.0, 2.0, 1.0, 0.0, -1.0], [0.0, 0.04, 0.04, 0.03, 0.16]],
    ids=str,
)
def test_stamps_that_do_not_rise_leave_frames_in_order(
    stamps: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    times = timed(stamps, 25.0, monkeypatch)
    np.testing.assert_allclose(times, np.arange(5) / 25, atol=1e-9)


def test_stamps_count_from_the_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    times = timed([7.0, 7.5, 9.0], 25.0, monkeypatch)
    np.testing.assert_allclose(times, [0.0, 0.5, 2.0])


# --- Pages and formats of images -----------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 5, 37])
@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".TIFF"])
def test_all_pages_of_a_tiff_are_frames(tmp_path: Path, count: int, suffix: str) -> None:
    frames = deep_frames(count)
    assert cv2.imwritemulti(str(tmp_path / "pages.tif"), frames)
    file = (tmp_path / "pages.tif").rename(tmp_path / f"clip{suffix}")
    times, images, encodings = imported(file, tmp_path / "bag", "--rate", "8")
    assert encodings == {"mono16"}
    np.testing.assert_array_equal(images, frames)
    np.testing.assert_allclose(times, np.arange(count) / 8, atol=1e-9)


def test_pages_of_several_files_follow_one_another(tmp_path: Path) -> None:
    frames = deep_frames(12)
    (tmp_path / "clip").mkdir()
    for place, part in enumerate((frames[:5], frames[5:6], frames[6:])):
        assert cv2.imwritemulti(str(tmp_path / "clip" / f"part{3 * place}.tif"), part)
    times, images, _ = imported(tmp_path / "clip", tmp_path / "bag")
    np.testing.assert_array_equal(images, frames)
    np.testing.assert_allclose(times, np.arange(12) / 30, atol=1e-9)


def test_pages_of_masks_pair_with_pages_of_frames(tmp_path: Path) -> None:
    assert cv2.imwritemulti(str(tmp_path / "clip.tif"), deep_frames(3))
    assert cv2.imwritemulti(str(tmp_path / "truth.tif"), [np.ones(SHAPE, np.uint8)] * 3)
    imported(tmp_path / "clip.tif", tmp_path / "bag", "--masks", str(tmp_path / "truth.tif"))
    assert BagReader(tmp_path / "bag").topics[TRUTH].message_count == 3


def test_of_a_tiff_that_was_cut_the_whole_pages_are_read(tmp_path: Path) -> None:
    frames = deep_frames(6)
    assert cv2.imwritemulti(str(tmp_path / "clip.tif"), frames)
    content = (tmp_path / "clip.tif").read_bytes()
    (tmp_path / "clip.tif").write_bytes(content[: len(content) // 2])
    _, images, _ = imported(tmp_path / "clip.tif", tmp_path / "bag")
    assert 1 <= len(images) < 6
    np.testing.assert_array_equal(images, frames[: len(images)])


@pytest.mark.parametrize("largest", [255, 1023, 4095, 65535])
def test_pgm_keeps_its_values(tmp_path: Path, largest: int) -> None:
    """Written by hand: cameras of 10 and 12 bits say what their largest value is."""
    random = np.random.default_rng(0)
    frames = [random.integers(0, largest + 1, SHAPE) for _ in range(3)]
    (tmp_path / "clip").mkdir()
    for number, frame in enumerate(frames):
        header = f"P5\n# made by hand\n{SHAPE[1]} {SHAPE[0]}\n{largest}\n".encode()
        data = frame.astype(np.uint8 if largest < 256 else ">u2").tobytes()
        (tmp_path / "clip" / f"{number:03}.pgm").write_bytes(header + data)
    _, images, encodings = imported(tmp_path / "clip", tmp_path / "bag")
    assert encodings == {"mono8" if largest < 256 else "mono16"}
    np.testing.assert_array_equal(images, frames)


@pytest.mark.parametrize("suffix", [".ppm", ".pnm", ".webp", ".jp2"])
def test_further_formats_of_images_are_frames(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "clip").mkdir()
    image = np.dstack([np.full(SHAPE, value, np.uint8) for value in (30, 120, 220)])
    for number in range(2):
        assert cv2.imwrite(str(tmp_path / "clip" / f"{number}{suffix}"), image)
    _, images, _ = imported(tmp_path / "clip", tmp_path / "bag")
    assert len(images) == 2
    assert np.abs(images[0].astype(int) - image).max() < 8


# --- Numbers and times in names ------------------------------------------------------------------


def save(folder: Path, names: Sequence[str]) -> Path:
    folder.mkdir()
    for name, image in zip(names, numbered(len(names)), strict=True):
        assert cv2.imwrite(str(folder / f"{name}.png"), image)
    return folder


def values(images: Sequence[np.ndarray]) -> list[int]:
    return [int(image[0, 0]) - 10 for image in images]


@pytest.mark.parametrize(
    ("names", "positions", "missing"),
    [
        (["0", "1", "2", "3"], [0, 1, 2, 3], 0),
        (["f007", "f008", "f009", "f012", "f013", "f014"], [0, 1, 2, 5, 6, 7], 2),
        (["f8_raw", "f9_raw", "f10_raw", "f13_raw"], [0, 1, 2, 5], 2),
        (["5", "10", "15", "20"], [0, 1, 2, 3], 0),
        (["5", "10", "15", "30", "35"], [0, 1, 2, 5, 6], 2),
        # Numbers that count something else, or several things.
        (["3", "17", "18", "99"], [0, 1, 2, 3], 0),
        (["a1", "a2", "b1", "b2"], [0, 1, 2, 3], 0),
        (["one", "three", "two"], [0, 1, 2], 0),
        (["1"], [0], 0),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) and value[:1] == ["0"] else None,
)
def test_numbers_that_are_left_out_keep_their_time(
    tmp_path: Path,
    names: list[str],
    positions: list[int],
    missing: int,
    capsys: pytest.CaptureFixture,
) -> None:
    clip = save(tmp_path / "clip", names)
    times, images, _ = imported(clip, tmp_path / "bag", "--rate", "10")
    assert values(images) == list(range(len(names)))
    np.testing.assert_allclose(times, np.array(positions) / 10, atol=1e-9)
    said = capsys.readouterr().err
    assert (f"{missing} frames are missing by their numbers" in said) == bool(missing)


@pytest.mark.parametrize(
    ("names", "seconds"),
    [
        (["1403636579763555584", "1403636579813555456", "1403636580263555584"], [0, 0.05, 0.5]),
        (["1305031102.175304", "1305031102.211214", "1305031103.000304"], [0, 0.03591, 0.825]),
        (["1403636579763555", "1403636579813555"], [0, 0.05]),
        (["1403636579763", "1403636579813"], [0, 0.05]),
    ],
    ids=["nanoseconds", "seconds", "microseconds", "milliseconds"],
)
def test_names_that_are_times_are_the_stamps(
    tmp_path: Path, names: list[str], seconds: list[float], capsys: pytest.CaptureFixture
) -> None:
    clip = save(tmp_path / "clip", names)
    times, images, _ = imported(clip, tmp_path / "bag")
    assert values(images) == list(range(len(names)))
    np.testing.assert_allclose(times, seconds, atol=1e-6)
    assert "the names are taken for times" in capsys.readouterr().err
    times, _, _ = imported(clip, tmp_path / "even", "--rate", "10")
    np.testing.assert_allclose(times, np.arange(len(names)) / 10, atol=1e-9)
