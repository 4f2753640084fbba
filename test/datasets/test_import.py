from __future__ import annotations

import signal
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from turbseg_ros.bag.errors import ClipError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli import import_
from turbseg_ros.cli.import_ import main
from turbseg_ros.datasets.masks import mask_meaning
from turbseg_ros.messages.images import image_from_message, stamp_to_ns

IMAGES = "/camera/image_raw"
TRUTH = "/ground_truth/labels"
SHAPE = (20, 30)
# The first colours of the DAVIS-2017 palette, as BGR.
PALETTE = np.array([(0, 0, 0), (0, 0, 128), (0, 128, 0), (0, 128, 128), (128, 0, 0)], np.uint8)


def grey_frames(count: int, dtype: type = np.uint8) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, np.iinfo(dtype).max, SHAPE, dtype) for _ in range(count)]


def colour_frames(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 255, (*SHAPE, 3), np.uint8) for _ in range(count)]


def save(folder: Path, images: list[np.ndarray], suffix: str = ".png") -> Path:
    folder.mkdir(parents=True)
    for number, image in enumerate(images):
        assert cv2.imwrite(str(folder / f"frame{number}{suffix}"), image)
    return folder


def save_video(path: Path, frames: list[np.ndarray], rate: float = 25.0) -> Path:
    height, width = frames[0].shape[:2]
    codec = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), codec, rate, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def imported(bag: Path, topic: str = IMAGES) -> tuple[list[int], list[np.ndarray], set[str]]:
    """Return the stamps, images and encodings of a topic."""
    records = list(BagReader(bag).messages([topic]))
    messages = [record.message() for record in records]
    assert [record.stamp_ns for record in records] == [
        stamp_to_ns(message.header.stamp) for message in messages
    ]
    return (
        [record.stamp_ns for record in records],
        [image_from_message(message) for message in messages],
        {message.encoding for message in messages},
    )


def refusal(capsys, *arguments: Path | str) -> str:
    """Import what must be refused; return the complaint, which must be one line."""
    assert main([str(argument) for argument in arguments]) == 2
    complaint = capsys.readouterr().err
    assert complaint.startswith("turbseg_import: ")
    assert complaint.count("\n") == 1
    return complaint


@pytest.mark.parametrize(
    ("frames", "suffix", "encoding"),
    [
        (grey_frames(3), ".png", "mono8"),
        (grey_frames(3, np.uint16), ".png", "mono16"),
        (grey_frames(3, np.uint16), ".tif", "mono16"),
        (colour_frames(3), ".tiff", "bgr8"),
        (colour_frames(3), ".BMP", "bgr8"),
        ([np.dstack([frame] * 3) for frame in grey_frames(3)], ".png", "mono8"),
        ([frame.astype(np.float32) for frame in grey_frames(3)], ".tif", "32FC1"),
    ],
)
def test_frames_keep_their_depth_and_are_grey_when_nothing_has_colour(
    tmp_path, frames, suffix, encoding
):
    assert main([str(save(tmp_path / "clip", frames, suffix)), str(tmp_path / "bag")]) == 0
    _, images, encodings = imported(tmp_path / "bag")
    assert encodings == {encoding}
    grey = not encoding.startswith("bgr")
    for image, frame in zip(images, frames, strict=True):
        np.testing.assert_array_equal(image, frame[:, :, 0] if grey and frame.ndim == 3 else frame)


def test_one_coloured_frame_makes_the_clip_coloured(tmp_path):
    frames = [*grey_frames(2), *colour_frames(1)]
    assert main([str(save(tmp_path / "clip", frames)), str(tmp_path / "bag")]) == 0
    _, images, encodings = imported(tmp_path / "bag")
    assert encodings == {"bgr8"}
    np.testing.assert_array_equal(images[0], np.dstack([frames[0]] * 3))
    np.testing.assert_array_equal(images[2], frames[2])


def test_frames_come_in_natural_order_at_the_asked_rate(tmp_path):
    frames = [np.full(SHAPE, value, np.uint8) for value in range(12)]
    clip = save(tmp_path / "clip", frames)
    (clip / ".hidden.png").write_bytes(b"")
    (clip / "notes.txt").write_text("not a frame")
    assert main([str(clip), str(tmp_path / "bag"), "--rate", "8", "--topic", "/thermal"]) == 0
    stamps, images, _ = imported(tmp_path / "bag", "/thermal")
    assert [image[0, 0] for image in images] == list(range(12))
    assert set(np.diff(stamps)) == {125_000_000}
    assert stamps[0] > 0


def test_a_video_comes_with_its_own_rate(tmp_path):
    blurred = [cv2.GaussianBlur(frame, None, 3.0) for frame in colour_frames(5)]
    video = save_video(tmp_path / "clip.avi", blurred, rate=25.0)
    assert main([str(video), str(tmp_path / "bag")]) == 0
    stamps, images, encodings = imported(tmp_path / "bag")
    assert encodings == {"bgr8"}
    assert set(np.diff(stamps)) == {40_000_000}
    for image, frame in zip(images, blurred, strict=True):
        assert np.abs(image.astype(int) - frame).mean() < 5


def test_masks_are_paired_by_order_at_the_frames_stamps(tmp_path):
    masks = [np.zeros(SHAPE, np.uint8) for _ in range(3)]
    masks[1][3:7, 4:9] = 255
    frames = save(tmp_path / "clip", grey_frames(3))
    folder = save(tmp_path / "truth", masks)
    assert main([str(frames), str(tmp_path / "bag"), "--masks", str(folder)]) == 0
    stamps, labels, encodings = imported(tmp_path / "bag", TRUTH)
    assert stamps == imported(tmp_path / "bag")[0]
    assert encodings == {"mono8"}
    for label, mask in zip(labels, masks, strict=True):
        np.testing.assert_array_equal(label, mask)


def test_a_video_takes_masks_too(tmp_path):
    video = save_video(tmp_path / "clip.avi", colour_frames(3))
    masks = save(tmp_path / "masks", [np.ones(SHAPE, np.uint8)] * 3)
    assert main([str(video), str(tmp_path / "bag"), "--masks", str(masks)]) == 0
    assert len(imported(tmp_path / "bag", TRUTH)[1]) == 3


@pytest.mark.parametrize(
    "names", [("frames", "masks"), ("Images", "GT"), ("input", "annotations")]
)
def test_frames_and_masks_beside_one_another_are_found(tmp_path, names):
    save(tmp_path / "car" / names[0], grey_frames(2))
    save(tmp_path / "car" / names[1], [np.ones(SHAPE, np.uint8)] * 2)
    assert main([str(tmp_path / "car"), str(tmp_path / "bag")]) == 0
    assert len(imported(tmp_path / "bag", TRUTH)[1]) == 2


def test_the_folder_of_frames_alone_comes_without_masks(tmp_path):
    save(tmp_path / "car" / "frames", grey_frames(2))
    save(tmp_path / "car" / "masks", [np.ones(SHAPE, np.uint8)] * 2)
    assert main([str(tmp_path / "car" / "frames"), str(tmp_path / "bag")]) == 0
    assert list(BagReader(tmp_path / "bag").topics) == [IMAGES]


def test_davis_annotations_are_found(tmp_path):
    frames = save(tmp_path / "JPEGImages" / "480p" / "bear", colour_frames(2), ".jpg")
    masks = [PALETTE[np.resize(np.arange(5), SHAPE)]] * 2
    save(tmp_path / "Annotations" / "480p" / "bear", masks)
    assert main([str(frames), str(tmp_path / "bag")]) == 0
    for labels in imported(tmp_path / "bag", TRUTH)[1]:
        np.testing.assert_array_equal(labels, np.resize(np.arange(5), SHAPE))


@pytest.mark.parametrize(
    "trees", [("JPEGImages", "Annotations"), ("images", "masks"), ("Input", "GT")]
)
def test_masks_are_found_in_a_tree_beside_that_of_the_frames(tmp_path, trees):
    frames = save(tmp_path / trees[0] / "Single_Car", grey_frames(2))
    save(tmp_path / trees[1] / "Single_Car", [np.ones(SHAPE, np.uint8)] * 2)
    save(tmp_path / trees[1] / "Blue_Car", [np.ones(SHAPE, np.uint8)] * 3)
    assert main([str(frames), str(tmp_path / "bag")]) == 0
    assert len(imported(tmp_path / "bag", TRUTH)[1]) == 2


def test_a_sequence_without_masks_in_the_tree_comes_without(tmp_path):
    frames = save(tmp_path / "images" / "Single_Car", grey_frames(2))
    save(tmp_path / "masks" / "Blue_Car", [np.ones(SHAPE, np.uint8)] * 2)
    assert main([str(frames), str(tmp_path / "bag")]) == 0
    assert list(BagReader(tmp_path / "bag").topics) == [IMAGES]


LABELS = hnp.arrays(np.uint8, SHAPE, elements=st.integers(0, 4))


@given(LABELS.filter(lambda labels: len(np.unique(labels[labels > 0])) > 1))
def test_small_numbers_and_palette_colours_are_labels(labels):
    for mask in (labels, labels.astype(np.uint16), np.dstack([labels] * 3), PALETTE[labels]):
        np.testing.assert_array_equal(mask_meaning([mask]).labels(mask), labels)


@given(hnp.arrays(np.bool_, SHAPE), st.integers(1, 254))
def test_a_single_value_is_one_object(drawn, value):
    grey = drawn.astype(np.uint8) * np.uint8(value)
    for mask in (grey, grey.astype(np.uint16) * 257, np.dstack([grey] * 3)):
        np.testing.assert_array_equal(mask_meaning([mask]).labels(mask), drawn)
    red = grey[:, :, None] * np.array([0, 0, 1], np.uint8)
    np.testing.assert_array_equal(mask_meaning([red]).labels(red), drawn)


@given(hnp.arrays(np.bool_, SHAPE))
def test_white_is_foreground_in_which_objects_are_not_told_apart(drawn):
    grey = drawn.astype(np.uint8) * np.uint8(255)
    for mask in (grey, grey.astype(np.uint16) * 257, np.dstack([grey] * 3)):
        labels = mask_meaning([mask]).labels(mask)
        assert labels.dtype == np.uint8
        np.testing.assert_array_equal(labels, grey)


def test_the_meaning_is_that_of_all_masks_together():
    first = np.full(SHAPE, 2, np.uint8)
    second = np.full(SHAPE, 3, np.uint8)
    meaning = mask_meaning([first, second])
    assert np.all(meaning.labels(first) == 2)
    assert np.all(meaning.labels(second) == 3)


def test_labels_above_255_stay_apart():
    mask = np.resize(np.array([0, 1, 300], np.uint16), SHAPE)
    assert mask_meaning([mask]).labels(mask).dtype == np.uint16
    np.testing.assert_array_equal(mask_meaning([mask]).labels(mask), mask)


@pytest.mark.parametrize(
    ("mask", "complaint"),
    [
        (np.resize(np.array([0, 1, 255], np.uint8), SHAPE), "hold 255 beside 1"),
        (np.arange(600, dtype=np.uint16).reshape(SHAPE), "600 values"),
        (np.resize(np.array([[0, 0, 255], [9, 9, 8]], np.uint8), (*SHAPE, 3)), "#080909, #ff0000"),
        (np.zeros(SHAPE, np.float32), "masks are float32"),
    ],
)
def test_masks_that_could_mean_anything_are_refused(mask, complaint):
    with pytest.raises(ClipError, match=complaint):
        mask_meaning([mask])


def test_numbers_that_do_not_match_are_named(tmp_path, capsys):
    frames = save(tmp_path / "clip", grey_frames(3))
    masks = save(tmp_path / "truth", [np.ones(SHAPE, np.uint8)] * 2)
    complaint = refusal(capsys, frames, tmp_path / "bag", "--masks", masks)
    assert "3 frames" in complaint
    assert "2 masks" in complaint
    video = save_video(tmp_path / "clip.avi", colour_frames(4))
    complaint = refusal(capsys, video, tmp_path / "bag", "--masks", masks)
    assert "4 frames" in complaint


def test_sizes_that_do_not_match_are_named_and_leave_nothing(tmp_path, capsys):
    frames = save(tmp_path / "clip", grey_frames(2))
    masks = save(tmp_path / "truth", [np.ones((10, 12), np.uint8)] * 2)
    complaint = refusal(capsys, frames, tmp_path / "out" / "bag", "--masks", masks)
    assert "mask 0 is 12x10, its frame 30x20" in complaint
    assert list((tmp_path / "out").iterdir()) == []


def test_frames_that_differ_are_named_and_leave_nothing(tmp_path, capsys):
    frames = save(tmp_path / "clip", [*grey_frames(2), np.zeros((7, 9), np.uint8)])
    complaint = refusal(capsys, frames, tmp_path / "out" / "bag")
    assert "frame 2 is 9x7 uint8, the first 30x20 uint8" in complaint
    assert list((tmp_path / "out").iterdir()) == []


def test_a_source_that_is_none_is_named(tmp_path, capsys):
    assert "no such video or folder" in refusal(capsys, tmp_path / "missing", tmp_path / "bag")
    (tmp_path / "empty").mkdir()
    assert "no folders of frames" in refusal(capsys, tmp_path / "empty", tmp_path / "bag")
    (tmp_path / "text.mp4").write_text("not a video")
    assert "text.mp4 is not a video" in refusal(capsys, tmp_path / "text.mp4", tmp_path / "bag")
    clip = save(tmp_path / "clip", grey_frames(1))
    (clip / "frame1.png").write_bytes(b"not an image")
    assert "frame1.png is not an image" in refusal(capsys, clip, tmp_path / "bag")
    complaint = refusal(capsys, clip, tmp_path / "bag", "--masks", tmp_path / "missing")
    assert "no such folder" in complaint


def test_several_folders_of_masks_are_named(tmp_path, capsys):
    save(tmp_path / "car" / "frames", grey_frames(2))
    save(tmp_path / "car" / "masks", grey_frames(2))
    save(tmp_path / "car" / "gt", grey_frames(2))
    complaint = refusal(capsys, tmp_path / "car", tmp_path / "bag")
    assert f"choose with --masks: {tmp_path / 'car' / 'gt'}, " in complaint
    frames = save(tmp_path / "images" / "bus", grey_frames(2))
    save(tmp_path / "masks" / "bus", grey_frames(2))
    save(tmp_path / "gt" / "bus", grey_frames(2))
    assert "choose with --masks: " in refusal(capsys, frames, tmp_path / "bag")


def test_an_existing_bag_is_kept(tmp_path, capsys):
    clip = save(tmp_path / "clip", grey_frames(1))
    (tmp_path / "bag").write_text("precious")
    assert "exists already" in refusal(capsys, clip, tmp_path / "bag")
    assert (tmp_path / "bag").read_text() == "precious"


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf", "fast"])
def test_an_impossible_rate_is_refused(rate, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["clip", "bag", f"--rate={rate}"])
    assert caught.value.code == 2
    assert "--rate" in capsys.readouterr().err


def test_frames_that_no_encoding_stores_are_refused(tmp_path, capsys):
    frames = save(tmp_path / "clip", [np.zeros(SHAPE)], ".tif")
    complaint = refusal(capsys, frames, tmp_path / "out" / "bag")
    assert "no encoding stores float64 images" in complaint
    assert list((tmp_path / "out").iterdir()) == []


def test_an_interrupted_import_keeps_the_frames_there_are(tmp_path, capsys, monkeypatch):
    frames = save(tmp_path / "clip", grey_frames(9))
    make = import_._message
    made = []

    def interrupting(image, stamp):
        made.append(stamp)
        if len(made) == 4:
            signal.raise_signal(signal.SIGTERM)
        return make(image, stamp)

    monkeypatch.setattr(import_, "_message", interrupting)
    assert main([str(frames), str(tmp_path / "bag")]) == 128 + signal.SIGTERM
    stamps, _, _ = imported(tmp_path / "bag")
    assert len(stamps) == 4
    partial = "interrupted after 4 of 9 frames"
    assert partial in (tmp_path / "bag" / "metadata.yaml").read_text()
    error = capsys.readouterr().err
    assert error == f"turbseg_import: {tmp_path / 'bag'} is partial: {partial}\n"


def test_levels_of_cdnet_are_foreground_background_and_what_is_not_judged(tmp_path):
    masks = [np.full(SHAPE, level, np.uint8) for level in (85, 0, 50, 170)]
    for mask in masks[1:]:
        mask[:3] = 255
    save(tmp_path / "clip" / "input", grey_frames(4))
    save(tmp_path / "clip" / "groundtruth", masks)
    assert main([str(tmp_path / "clip"), str(tmp_path / "bag")]) == 0
    _, labels, _ = imported(tmp_path / "bag", TRUTH)
    assert [set(np.unique(each)) for each in labels] == [{0}, {0, 255}, {0, 255}, {0, 255}]
    _, ignored, _ = imported(tmp_path / "bag", "/ground_truth/ignored")
    assert [np.count_nonzero(each[3:]) for each in ignored] == [510, 0, 0, 510]
    assert [np.count_nonzero(each[:3]) for each in ignored] == [90, 0, 0, 0]
