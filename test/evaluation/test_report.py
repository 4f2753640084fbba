"""The report: one page that needs nothing else, as text and as a browser shows it."""

from __future__ import annotations

import dataclasses
import html
import html.parser
import json
import math
import re
import sys
import xml.etree.ElementTree
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from support import browser
from support.drawn_bag import write_drawn_bag
from turbseg_ros.cli.evaluate import main
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.evaluation import baselines
from turbseg_ros.evaluation.chart import Chart, Line, round_values
from turbseg_ros.evaluation.experiments import ScoredExperiment, ScoredRow, sensitivity
from turbseg_ros.evaluation.origin import Origin
from turbseg_ros.evaluation.pictures import FALSE, MISSED, Illustrator, Picture
from turbseg_ros.evaluation.report import ReportError, ReportWriter
from turbseg_ros.evaluation.scores import Measurements, Scorer
from turbseg_ros.messages.detections import Detection
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

pytest.importorskip("jinja2", reason="Jinja is not installed")

FRAMES = 12
# A name that a page must not take for its own language.
AWKWARD = "a&b <i>"
FETCHING = {"src", "href", "srcset", "poster", "data", "action", "background"}


class DarkAreas:
    """Finds what is darker than the drawn ground ever is."""

    def __init__(self, parameters: Parameters) -> None:
        pass

    def push(self, frame: Frame) -> list[SegmentationResult]:
        labels = (frame.image < 60).astype(np.uint16)
        left, top, width, height = cv2.boundingRect(labels.astype(np.uint8))
        score = 0.6 if left < 30 else 0.99
        box, centre = (left, top, width, height), (left + width / 2, top + height / 2)
        found = MovingObject(1, 0, centre, (3.0, 0.0), width * height, box, score=score)
        motion = np.zeros((0, 0), np.float32)
        return [SegmentationResult(frame, labels, (found,), motion, 0.4, "affine")]

    def flush(self) -> list[SegmentationResult]:
        return []


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report with everything that there is."""
    folder = tmp_path_factory.mktemp("report")
    stamps = [number * 33_000_000 for number in range(FRAMES)]
    bags = [write_drawn_bag(folder / name, stamps) for name in ("one", AWKWARD)]
    comparisons = ["--baselines", "mog2,knn", "--tilt-curve", "0,1,2"]
    comparisons += ["--ablation", "--sensitivity", "--variant", "flow.interval:=2"]
    comparisons += ["--shake-curve", "0,1", "-p", "max_objects:=4"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(baselines, "clip_segmenter", DarkAreas)
        report = ["--report", str(folder / "out"), "--workers", "1"]
        report += ["--curves", str(folder / "curves")]
        assert main([*map(str, bags), *comparisons, *report]) == 0
    return folder / "out" / "index.html"


class References(html.parser.HTMLParser):
    """Collects what a page refers to, its ids, and whether its tags are closed in order."""

    VOID = frozenset({"meta", "link", "img", "br", "hr", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.urls: list[str] = []
        self.ids: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.urls += [value or "" for name, value in attrs if name in FETCHING]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.urls += [value or "" for name, value in attrs if name in FETCHING]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, self.getpos()


def test_the_page_is_one_file_that_refers_to_nothing_outside(page: Path) -> None:
    assert [entry.name for entry in page.parent.iterdir()] == ["index.html"]
    text = page.read_text()
    references = References(text)
    outside = [url for url in references.urls if not url.startswith(("data:", "#"))]
    assert outside == []
    assert "@import" not in text
    assert not re.search(r"url\(", text)
    anchors = {url[1:] for url in references.urls if url.startswith("#")}
    assert anchors <= set(references.ids)
    assert len(references.ids) == len(set(references.ids))
    assert references.open == []


def test_the_page_shows_every_experiment_and_picture(page: Path) -> None:
    text = page.read_text()
    for key in ("baselines", "tilt_curve", "shake_curve", "ablation", "sensitivity", "comparison"):
        assert f'id="{key}"' in text
    # For each bag 6 tiles and the same frame by 5 segmenters; this method has no bad frames.
    assert text.count("<img") == 2 * (6 + 5)
    # Two curves, J over the frames of each bag, and whether scores are what they say.
    assert text.count("<svg") == 5
    assert re.search(r'aria-label="Whether scores are what they say"', text)
    # All of both scores are true.
    assert re.search(r"objects that are true: 1.000 at 0.6<", text)
    assert re.search(r"as scores say: 0.990 at 0.99<", text)
    assert "max_objects" in text


@pytest.mark.parametrize("name", ["tilt_curve", "shake_curve"])
def test_a_curve_is_a_picture_that_needs_nothing_else(page: Path, name: str) -> None:
    path = page.parent.parent / "curves" / f"{name}.svg"
    picture = xml.etree.ElementTree.parse(path).getroot()
    svg = "{http://www.w3.org/2000/svg}"
    assert picture.tag == f"{svg}svg"
    words = [text.text for text in picture.iter(f"{svg}text")]
    segmenters = ["turbseg", "mog2", "mog2 stabilised", "knn", "knn stabilised"]
    assert [word for word in words if word in segmenters] == segmenters
    assert len(list(picture.iter(f"{svg}polyline"))) == len(segmenters)
    text = path.read_text().replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"://|url\(|@import|href", text)


def test_tables_name_bags_without_the_folders_that_they_share(page: Path) -> None:
    names = re.findall(r'<a href="#bag\d+" title="([^"]*)">([^<]*)</a>', page.read_text())
    assert [short for _, short in names] == ["one", html.escape(AWKWARD)]
    assert all(full.endswith(f"/{short}") for full, short in names)


def test_names_are_text_and_nothing_else(page: Path) -> None:
    text = page.read_text()
    assert "a&amp;b &lt;i&gt;" in text
    assert "<i>" not in text


@pytest.fixture(scope="module")
def shown(page: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[browser.Page]:
    """The page in headless Chromium."""
    if browser.EXECUTABLE is None:
        pytest.skip("Chromium is not installed")
    with browser.browser_page(tmp_path_factory.mktemp("profile")) as tab:
        tab.open(page.as_uri())
        yield tab


def test_in_a_browser_every_picture_loads(shown: browser.Page) -> None:
    loaded = "[...document.images].map(image => image.complete && image.naturalWidth)"
    widths = shown.evaluate(loaded)
    assert len(widths) == 22
    assert all(width == 480 for width in widths)


def test_in_a_browser_nothing_goes_wrong_and_nothing_is_fetched(
    shown: browser.Page, page: Path
) -> None:
    assert not shown.happened("Runtime.exceptionThrown")
    assert not shown.happened("Log.entryAdded")
    requests = [event["request"]["url"] for event in shown.happened("Network.requestWillBeSent")]
    assert page.as_uri() in requests
    assert [url for url in requests if not url.startswith(("data:", page.as_uri()))] == []


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("dark", [False, True])
def test_in_a_browser_the_page_fits_the_screen(
    width: int, dark: bool, shown: browser.Page
) -> None:
    shown.resize(width, 800, dark)
    assert shown.evaluate("document.documentElement.scrollWidth") == width
    colours = shown.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
    )
    ink, paper = (sum(map(int, re.findall(r"\d+", colour)[:3])) for colour in colours)
    assert (ink > paper) == dark
    assert abs(ink - paper) > 500
    letters = "[...document.querySelectorAll('svg text')]"
    smallest = f"Math.min(...{letters}.map(t => t.getBBox().height * t.getCTM().a))"
    assert shown.evaluate(smallest) > 10


def test_in_a_browser_a_click_enlarges_a_picture_and_another_one_ends_that(
    shown: browser.Page,
) -> None:
    shown.resize(1280, 800)
    box = "JSON.stringify(document.images[0].getBoundingClientRect())"
    click = "document.images[0].closest('label').click()"
    before = json.loads(shown.evaluate(box))
    shown.evaluate(click)
    large = json.loads(shown.evaluate(box))
    assert before["width"] < 400
    assert (large["width"], large["height"]) == (1248, 768)
    on_top = "document.elementFromPoint(640, 400) === document.images[0]"
    assert shown.evaluate(on_top)
    shown.evaluate(click)
    assert json.loads(shown.evaluate(box))["width"] == before["width"]


def test_in_a_browser_the_legend_has_the_colours_of_the_pictures(shown: browser.Page) -> None:
    for name, (blue, green, red) in (("missed", MISSED), ("false", FALSE)):
        swatch = f"getComputedStyle(document.querySelector('.marks .{name}')).backgroundColor"
        assert shown.evaluate(swatch) == f"rgb({red}, {green}, {blue})"


def test_the_page_tells_when_and_where_and_by_which_code_it_was_made(page: Path) -> None:
    (footer,) = re.findall(r"<footer>(.*?)</footer>", page.read_text(), re.S)
    told = " ".join(html.unescape(re.sub(r"<[^>]*>", "", footer)).split())
    origin = Origin.here_and_now()
    assert f"Made on {origin.date[:10]}" in told
    assert f"on {origin.processor}, {origin.cores} core" in told
    for name, version in origin.versions.items():
        assert f"{name} {version}" in told
    assert (origin.commit is None) == ("commit" not in told)


def test_what_changes_the_result_most_comes_first() -> None:
    experiment = sensitivity([], Parameters())
    js = [0.5, 0.49, None, 0.9, 0.2]
    bags = [dataclasses.replace(Scorer().scores("one", 1, Measurements()), j=j) for j in js]
    rows = tuple(
        ScoredRow(f"{j}", None, {}, () if j is None else (bag,))
        for j, bag in zip(js, bags, strict=True)
    )
    ordered = ScoredExperiment(experiment, rows).by_effect()
    assert [row.name for row in ordered.rows] == ["0.5", "0.9", "0.2", "0.49", "None"]
    assert ScoredExperiment(experiment, ()).by_effect().rows == ()


def test_without_jinja_a_report_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(ReportError, match=re.escape(how_to_install("jinja2"))):
        ReportWriter()


def result(number: int, found: float) -> tuple[SegmentationResult, np.ndarray]:
    """A result that found this share of the true object, and the truth."""
    truth, labels = (np.zeros((90, 160), np.uint16) for _ in range(2))
    truth[40:50, 50:70] = 1
    labels[40:50, 50 : 50 + round(20 * found)] = 1
    frame = Frame(number, np.full((90, 160), 90, np.uint8))
    return SegmentationResult(frame, labels, (), np.zeros((0, 0), np.float32), math.nan, ""), truth


def test_the_worst_frames_lie_apart_and_are_in_order() -> None:
    illustrator = Illustrator(90, [])
    found = np.full(90, 0.9)
    found[[20, 21, 22]] = 0.1, 0.0, 0.1
    found[70], found[5], found[50] = 0.3, 0.2, 0.5
    for number, share in enumerate(found):
        illustrator.add(*result(number, share))
    pictures = illustrator.illustrations()
    captions = [picture.caption for picture in pictures.worst]
    assert captions == ["frame 5, J 0.20", "frame 21, J 0.00", "frame 70, J 0.30"]
    assert [number for number, _ in pictures.j] == list(range(90))
    assert [picture.caption for picture in pictures.tiles][::5] == [
        "frame 0, J 0.90",
        "frame 89, J 0.90",
    ]


def test_a_close_up_shows_what_is_wrong_and_keeps_the_proportions() -> None:
    illustrator = Illustrator(1, [])
    illustrator.add(*result(0, 0.5))
    (close_up,) = illustrator.illustrations().worst
    assert (close_up.width, close_up.height) == (480, 270)


def test_captions_tell_false_alarms_and_unknown_truth() -> None:
    illustrator = Illustrator(3, [])
    alarm, truth = result(0, 1.0)
    illustrator.add(alarm, np.zeros_like(truth))
    illustrator.add(result(1, 0.0)[0], np.zeros_like(truth))
    illustrator.add(alarm, None)
    pictures = illustrator.illustrations()
    assert [picture.caption for picture in pictures.tiles] == [
        "frame 0, nothing there, false alarm",
        "frame 1, nothing there",
        "frame 2",
    ]
    assert [picture.caption for picture in pictures.worst] == [pictures.tiles[0].caption]
    assert pictures.j == ()


def chart(*values: tuple[float, float]) -> Chart:
    return Chart("title", "x", "y", (Line("line", values),))


def decoded(picture: Picture) -> np.ndarray:
    encoded = np.frombuffer(picture.jpeg, np.uint8)
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR)).astype(int)


def test_what_is_missed_is_blue_and_what_is_false_is_red() -> None:
    illustrator = Illustrator(1, [])
    found, truth = result(0, 1.0)
    illustrator.add(found, np.roll(truth, 10, axis=1))
    image = decoded(illustrator.illustrations().tiles[0])
    # Three pixels to one of the frame: false at its column 55, right at 65, missed at 75.
    (blue, _, red), right, missed = (image[135, column] for column in (165, 195, 225))
    assert red > blue + 50
    assert missed[0] > missed[2] + 50
    assert np.ptp(right) < 20


def test_true_boxes_are_drawn_and_the_worst_frames_are_those_without_hits() -> None:
    illustrator = Illustrator(30, [])
    for number in range(30):
        true = Detection((50.0, 40.0, 20.0, 10.0), "1"), Detection((100.0, 60.0, 20.0, 10.0), "2")
        illustrator.add(result(number, 1.0 if number != 11 else 0.0)[0], true)
    pictures = illustrator.illustrations()
    assert "frame 11, 0 of 2 boxes hit" in [picture.caption for picture in pictures.worst]
    assert pictures.tiles[0].caption == "frame 0, 1 of 2 boxes hit"
    image = decoded(pictures.tiles[0])
    assert image[119:122, 180].max() > 180  # the upper edge of the first, in white
    blue, _, red = image[195, 330]  # within the second
    assert blue > red + 50


def test_pictures_have_the_frames_own_size_within_bounds() -> None:
    def width(columns: int) -> int:
        illustrator = Illustrator(1, [])
        frame = Frame(0, np.zeros((columns // 2, columns), np.uint8))
        illustrator.add(SegmentationResult.empty(frame), None)
        return illustrator.illustrations().tiles[0].width

    assert [width(columns) for columns in (200, 640, 1920)] == [480, 640, 800]


@given(
    st.lists(
        st.tuples(st.floats(-1e6, 1e6), st.floats(0, 1)), min_size=1, unique_by=lambda p: p[0]
    )
)
def test_a_chart_draws_inside_its_axes(values: list[tuple[float, float]]) -> None:
    drawing = chart(*sorted(values))
    points = list(drawing.points(drawing.lines[0]))
    assert all(drawing.left <= point.x <= drawing.right for point in points)
    assert all(drawing.top <= point.y <= drawing.bottom for point in points)
    assert [point.x for point in points] == sorted(point.x for point in points)
    assert all(drawing.left <= tick.position <= drawing.right for tick in drawing.x_ticks)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_round_values_are_few_and_within(low: float, span: float) -> None:
    high = low + span
    assume(high > low)
    values = round_values(low, high)
    assert 1 <= len(values) <= 9
    slack = 1e-9 * max(abs(low), abs(high))
    assert all(low - slack <= value <= high + slack for value in values)


def test_ticks_are_the_strengths_where_they_are_given() -> None:
    drawing = Chart("t", "x", "y", (Line("a", ((0, 1), (3, 0))),), x_values=(0, 0.5, 3))
    assert [tick.label for tick in drawing.x_ticks] == ["0", "0.5", "3"]
    assert drawing.x_ticks[-1].position == drawing.right
    assert [tick.label for tick in chart((0, 0), (51, 1)).x_ticks] == [
        "0", "10", "20", "30", "40", "50",
    ]  # fmt: skip


def test_no_range_has_no_round_values() -> None:
    with pytest.raises(ValueError, match="no range from 1 to 1"):
        round_values(1, 1)
