"""Node, player and viewer as three processes over DDS, and the page in a browser."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import signal
import struct
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

pytest.importorskip("aiohttp", reason="aiohttp is not installed")

from aiohttp import ClientSession, ClientWebSocketResponse, WSMsgType

from support import browser
from support.node_harness import NodeProcess
from support.paths import BAGS
from turbseg_ros.segmentation.camera_state import CameraState

# Seconds; a busy machine takes ten times as long as an idle one.
TIMEOUT = 90.0
COMMAND = (sys.executable, "-m", "turbseg_ros.cli")
CAMERA = ("-r", "image_raw:=/camera/image_raw")
SIZE = (512, 288)

pytestmark = pytest.mark.timeout(300)


@dataclass
class Scene:
    """What runs, and where the page is; `start_node` replaces a node that has ended."""

    folder: Path
    address: str
    view: NodeProcess
    node: NodeProcess

    def start_node(self) -> None:
        self.node = NodeProcess(self.folder / "node.log", *CAMERA)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    folder = tmp_path_factory.mktemp("view")
    play = (*COMMAND, "play", str(BAGS / "normal"), "--loop", "--stamp-now")
    view = (*COMMAND, "view", "--port", "0", "--regions", str(folder / "regions.yaml"))
    with contextlib.ExitStack() as running:
        running.enter_context(NodeProcess(folder / "play.log", command=play))
        viewer = running.enter_context(NodeProcess(folder / "view.log", command=view))
        address = wait_for(lambda: re.search(r"open (http://\S+)", viewer.output))
        made = Scene(folder, address[1], viewer, NodeProcess(folder / "node.log", *CAMERA))
        running.callback(lambda: made.node.__exit__())
        yield made
        assert viewer.stop(signal.SIGINT) == 0
        assert "Traceback" not in viewer.output


def wait_for(condition: Callable[[], Any]) -> Any:
    """Return what a condition gives once it holds."""
    deadline = time.monotonic() + TIMEOUT
    while not (found := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    return found


def run(test: Awaitable[None]) -> None:
    async def limited() -> None:
        await asyncio.wait_for(test, 3 * TIMEOUT)

    asyncio.run(limited())


@contextlib.asynccontextmanager
async def connected(scene: Scene) -> AsyncIterator[ClientWebSocketResponse]:
    async with ClientSession() as session, session.ws_connect(f"{scene.address}ws") as socket:
        yield socket


async def told(
    socket: ClientWebSocketResponse, kind: str, wanted: Callable[[dict[str, Any]], object]
) -> dict[str, Any]:
    """Return the first text of a kind that is as wanted."""
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        message = await socket.receive(timeout=TIMEOUT)
        if message.type is WSMsgType.BINARY:
            await socket.send_json({"kind": "shown"})
        elif message.type is WSMsgType.TEXT:
            content = dict(json.loads(message.data))
            if content["kind"] == kind and wanted(content):
                return content
    raise AssertionError(f"no {kind} as wanted")


async def shown_picture(socket: ClientWebSocketResponse) -> tuple[dict[str, Any], Any]:
    """Return the header of the first picture with an object, and the picture."""
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        message = await socket.receive(timeout=TIMEOUT)
        if message.type is WSMsgType.BINARY:
            (length,) = struct.unpack_from(">I", message.data)
            header = json.loads(message.data[4 : 4 + length])
            if header["objects"]:
                jpeg = np.frombuffer(message.data[4 + length :], np.uint8)
                return header, cv2.imdecode(jpeg, cv2.IMREAD_UNCHANGED)
            await socket.send_json({"kind": "shown"})
    raise AssertionError("no picture with an object")


def test_what_the_node_finds_is_seen_with_its_picture(scene: Scene) -> None:
    async def look() -> None:
        async with connected(scene) as socket:
            summary = await told(socket, "summary", lambda told: told["objects"])
            assert (summary["node"], summary["there"]) == ("/turbseg", True)
            assert summary["figures"]["input topic"] == "/camera/image_raw"
            first = summary["objects"][0]
            assert 10 < first["size"][0] < 200
            await told(socket, "summary", lambda told: any(o["speed"] for o in told["objects"]))
            header, image = await shown_picture(socket)
            assert (header["width"], header["height"]) == SIZE
            assert (image.shape[1], image.shape[0]) == SIZE
            corners = np.array(header["objects"][0]["outlines"][0])
            assert ((corners >= 0) & (corners < SIZE)).all()

    run(look())


def value_of(name: str, told: dict[str, Any]) -> object:
    values = {each["name"]: each["value"] for each in told["parameters"]}
    return values.get(name)


def test_a_parameter_is_set_on_the_node_and_a_refusal_comes_back(scene: Scene) -> None:
    async def change() -> None:
        async with connected(scene) as socket:
            listed = await told(socket, "parameters", lambda told: told["parameters"])
            named = {each["name"]: each for each in listed["parameters"]}
            assert (named["seed.delta1"]["minimum"], named["seed.delta1"]["maximum"]) == (1, 50)
            assert "resolution.processing" not in named
            await socket.send_json({"kind": "set", "name": "seed.delta1", "value": 6})
            assert (await told(socket, "set", bool))["problem"] == ""
            # Whoever comes now is told of it, too.
            async with connected(scene) as other:
                await told(other, "parameters", lambda told: value_of("seed.delta1", told) == 6.0)
            for name, value, reason in (
                ("seed.delta1", 1000, "seed.delta1"),
                ("seed.delta1", "much", "can't be 'much'"),
                ("resolution.processing", 500, "can't be changed while the node runs"),
            ):
                await socket.send_json({"kind": "set", "name": name, "value": value})
                assert reason in (await told(socket, "set", bool))["problem"]

    run(change())
    assert "seed.delta1 is now 6.0" in scene.node.output


def test_a_node_that_goes_is_missed_and_found_again(scene: Scene) -> None:
    async def look() -> None:
        async with connected(scene) as socket:
            await told(socket, "summary", lambda told: told["there"])
            assert scene.node.stop(signal.SIGINT) == 0
            try:
                gone = await told(socket, "summary", lambda told: not told["there"])
                assert (gone["node"], gone["objects"]) == ("/turbseg", [])
                async with connected(scene) as other:
                    await told(other, "parameters", lambda told: not told["parameters"])
            finally:
                scene.start_node()
            await told(socket, "summary", lambda told: told["there"])
            async with connected(scene) as other:
                await told(other, "parameters", lambda told: told["parameters"])
                await shown_picture(other)

    run(look())


@pytest.fixture(scope="module")
def tab(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Iterator[browser.Page]:
    if browser.EXECUTABLE is None:
        pytest.skip("chromium is not installed")
    with browser.browser_page(tmp_path_factory.mktemp("profile")) as page:
        yield page


EVERYTHING_SHOWN = (
    "state.bitmap !== null && state.points.length > 1 && "
    "document.querySelectorAll('#rows tr').length > 0 && "
    "document.querySelectorAll('.parameter').length > 0 && !$('camera').hidden"
)


def open_page(tab: browser.Page, scene: Scene, width: int, height: int, dark: bool) -> None:
    tab.resize(width, height, dark)
    tab.open(scene.address)
    wait_for(lambda: tab.evaluate(EVERYTHING_SHOWN))


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(1280, 860), (360, 740)], ids=["desk", "phone"])
def test_in_a_browser_all_is_shown_and_fits(
    width: int, height: int, dark: bool, tab: browser.Page, scene: Scene
) -> None:
    open_page(tab, scene, width, height, dark)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert tab.evaluate("$('banner').hidden")
    assert tab.evaluate("$('node').textContent") == "/turbseg"
    assert "px" in tab.evaluate("$('rows').textContent")
    assert tab.evaluate("$('camera').textContent") in {
        f"camera {each.value}" for each in CameraState
    }
    assert tab.evaluate("document.querySelectorAll('polyline').length") >= 3
    ground = tab.evaluate("getComputedStyle(document.body).backgroundColor")
    brightness = sum(map(int, re.findall(r"\d+", ground)[:3])) / 3
    assert (brightness < 60) if dark else (brightness > 200)
    # The picture has the proportions of the camera's.
    box = tab.evaluate(
        "(({width, height}) => [width, height])($('canvas').getBoundingClientRect())"
    )
    assert box[0] / box[1] == pytest.approx(SIZE[0] / SIZE[1], rel=0.02)


def test_in_a_browser_nothing_goes_wrong_and_nothing_is_fetched_from_elsewhere(
    tab: browser.Page, scene: Scene
) -> None:
    open_page(tab, scene, 1280, 860, False)
    assert tab.happened("Runtime.exceptionThrown") == []
    assert tab.happened("Log.entryAdded") == []
    urls = [event["request"]["url"] for event in tab.happened("Network.requestWillBeSent")]
    assert [url for url in urls if not url.startswith((scene.address, "data:"))] == []


def test_in_a_browser_objects_are_outlined_in_their_colours(
    tab: browser.Page, scene: Scene
) -> None:
    open_page(tab, scene, 1280, 860, False)
    # The camera is grey: what is coloured was drawn.
    coloured = """(() => {
        const { width, height } = $('canvas');
        const { data } = $('canvas').getContext('2d').getImageData(0, 0, width, height);
        let count = 0;
        for (let i = 0; i < data.length; i += 4) {
            const pixel = [...data.slice(i, i + 3)];
            count += Math.max(...pixel) - Math.min(...pixel) > 60;
        }
        return count;
    })()"""
    wait_for(lambda: tab.evaluate(coloured) > 100)


def test_in_a_browser_a_slider_sets_its_parameter_and_a_refusal_is_shown(
    tab: browser.Page, scene: Scene
) -> None:
    open_page(tab, scene, 1280, 860, False)
    control = "document.querySelector('[data-name=\"tracking.min_hits\"]')"
    tab.evaluate(f"{control}.querySelector('.explain').click()")
    assert "seen moving" in tab.evaluate(f"{control}.innerText")
    tab.evaluate(
        f"(() => {{ const s = {control}.querySelector('[type=range]');"
        "s.value = 0.3; s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change'));"
        "})()"
    )
    number = f"{control}.querySelector('[type=number]').value"
    chosen = tab.evaluate(number)
    wait_for(lambda: f"tracking.min_hits is now {chosen}" in scene.node.output)
    tab.evaluate(
        f"(() => {{ const n = {control}.querySelector('[type=number]');"
        "n.value = 999; n.dispatchEvent(new Event('change')); })()"
    )
    wait_for(lambda: tab.evaluate(f"{control}.querySelector('.refused').textContent"))
    assert tab.evaluate(number) == chosen


def press(tab: browser.Page, x: float, y: float, *further: tuple[float, float]) -> None:
    """Press the mouse at a place of the picture, in fractions, and let it go, maybe elsewhere."""
    left, top, width, height = tab.evaluate(
        "(({left, top, width, height}) => [left, top, width, height])"
        "($('canvas').getBoundingClientRect())"
    )

    def mouse(kind: str, at: tuple[float, float]) -> None:
        tab.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=left + at[0] * width,
            y=top + at[1] * height,
            button="left",
            buttons=1,
            clickCount=1,
        )

    mouse("mousePressed", (x, y))
    for at in further:
        mouse("mouseMoved", at)
    mouse("mouseReleased", further[-1] if further else (x, y))


def touch(tab: browser.Page, x: float, y: float) -> None:
    """Touch the picture at a place, in fractions."""
    left, top, width, height = tab.evaluate(
        "(({left, top, width, height}) => [left, top, width, height])"
        "($('canvas').getBoundingClientRect())"
    )
    point = {"x": left + x * width, "y": top + y * height}
    tab.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[point])
    tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])


TINT_AT = """(() => {
    const { width, height } = $('canvas');
    const pen = $('canvas').getContext('2d');
    const [red, green] = pen.getImageData(%f * width, %f * height, 1, 1).data;
    return red - green;
})()"""


def saved_regions(scene: Scene) -> list[dict[str, Any]]:
    path = scene.folder / "regions.yaml"
    return list(yaml.safe_load(path.read_text())["regions"]) if path.exists() else []


def test_in_a_browser_regions_are_drawn_saved_and_deleted(tab: browser.Page, scene: Scene) -> None:
    open_page(tab, scene, 1280, 860, False)
    tab.evaluate("$('ignore').click()")
    press(tab, 0.1, 0.1, (0.2, 0.2), (0.4, 0.3))
    assert tab.evaluate("state.regions.length") == 1
    # The camera is grey, and what is ignored is tinted red: from edge to edge.
    tints = [tab.evaluate(TINT_AT % place) for place in ((0.085, 0.2), (0.115, 0.2), (0.385, 0.2))]
    assert tints[0] < 10 < min(tints[1:])
    tab.resize(360, 740)
    tab.call("Emulation.setTouchEmulationEnabled", enabled=True)
    tab.evaluate("$('include').click(); window.scrollTo(0, 0)")
    for x, y in ((0.5, 0.5), (0.9, 0.5), (0.9, 0.9), (0.1, 0.1)):
        touch(tab, x, y)
    tab.evaluate("$('undo').click(); $('close').click()")
    tab.call("Emulation.setTouchEmulationEnabled", enabled=False)
    tab.evaluate("$('save').click()")
    wait_for(lambda: len(saved_regions(scene)) == 2)
    ignored, included = saved_regions(scene)
    assert (ignored["kind"], included["kind"]) == ("ignore", "include")
    width, height = SIZE
    wanted = [(0.1, 0.1), (0.4, 0.1), (0.4, 0.3), (0.1, 0.3)]
    for (x, y), corner in zip(wanted, ignored["polygon"], strict=True):
        assert corner == pytest.approx([x * width, y * height], abs=2.5)
    assert len(included["polygon"]) == 3
    assert included["polygon"][1] == pytest.approx([0.9 * width, 0.5 * height], abs=3)
    wait_for(lambda: "the node has taken it" in tab.evaluate("$('saved').textContent"))
    assert f"regions.file is now {scene.folder / 'regions.yaml'}" in scene.node.output
    assert tab.evaluate("$('save').disabled")
    delete_first = "document.querySelector('#regions button').click(); $('save').click()"
    tab.evaluate(delete_first)
    wait_for(lambda: [region["kind"] for region in saved_regions(scene)] == ["include"])
    # What is saved is there for whoever comes next.
    tab.open(scene.address)
    wait_for(lambda: tab.evaluate("state.regions.length") == 1)
    tab.evaluate(delete_first)
    wait_for(lambda: not saved_regions(scene))


def test_in_a_browser_the_page_says_that_the_node_is_away(tab: browser.Page, scene: Scene) -> None:
    open_page(tab, scene, 1280, 860, False)
    assert scene.node.stop(signal.SIGINT) == 0
    try:
        wait_for(lambda: "Nothing from /turbseg" in tab.evaluate("$('banner').textContent"))
        assert tab.evaluate("document.querySelectorAll('.parameter').length") == 0
    finally:
        scene.start_node()
    wait_for(lambda: tab.evaluate("$('banner').hidden"))
    wait_for(lambda: tab.evaluate("document.querySelectorAll('.parameter').length") > 0)
