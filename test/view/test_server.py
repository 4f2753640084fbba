"""The server, asked as browsers and others do: who is let in, what they get, and how much."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import Future
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("aiohttp", reason="aiohttp is not installed")

from aiohttp import ClientWebSocketResponse, WSMsgType, WSServerHandshakeError
from aiohttp.test_utils import TestClient, TestServer

from support.paths import ROOT
from turbseg_ros.view.access import Access
from turbseg_ros.view.regions import RegionFile
from turbseg_ros.view.server import ViewServer, page_address
from turbseg_ros.view.state import LiveParameter, Result, ShownObject, Status, ViewState

TOKEN = "a-long-secret"
ROAD = {"name": "road", "kind": "ignore", "polygon": [[0.1, 0.2], [0.5, 0.2], [0.5, 0.9]]}
PAGE = ROOT / "turbseg_ros" / "view" / "page"


class FakeNode:
    """Refuses what is called "bad", never answers what is called "silent"."""

    def __init__(self) -> None:
        self.watched: list[bool] = []
        self.set: list[tuple[str, object]] = []

    def watch(self, watched: bool) -> None:
        self.watched.append(watched)

    def set_parameter(self, name: str, value: object) -> Future[str]:
        self.set.append((name, value))
        answer: Future[str] = Future()
        if name != "silent":
            answer.set_result("it is bad" if name == "bad" else "")
        return answer


class Site:
    """A server with a state that the test tells, and a node that it looks at."""

    def __init__(self, folder: Path, token: str | None = None) -> None:
        self.state, self.node = ViewState(), FakeNode()
        self.file = RegionFile(folder / "regions.yaml")
        self.server = ViewServer(self.state, self.node, Access(token), self.file, 8080)

    @asynccontextmanager
    async def client(self) -> AsyncIterator[TestClient[Any, Any]]:
        async with TestClient(TestServer(self.server.application())) as client:
            yield client

    def show(self, stamp: int, jpeg: bytes = b"jpeg") -> None:
        """Tell a picture with one object."""
        found = ShownObject(7, "#ff0000", (((1.0, 2.0), (3.0, 2.0), (3.0, 4.0)),))
        self.state.tell_picture(jpeg, (160, 90), Result(stamp, (found,)), drawn=False)


def run(test: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(_awaited(test()), 60))


async def _awaited(awaitable: Awaitable[None]) -> None:
    await awaitable


async def text(socket: ClientWebSocketResponse, kind: str) -> dict[str, Any]:
    """Return the next text of a kind; what comes before it is passed over."""
    while True:
        message = await socket.receive(timeout=20)
        assert message.type in (WSMsgType.TEXT, WSMsgType.BINARY), message
        if message.type is WSMsgType.TEXT:
            told = dict(json.loads(message.data))
            if told["kind"] == kind:
                return told


async def picture(socket: ClientWebSocketResponse) -> tuple[dict[str, Any], bytes]:
    """Return the header and the JPEG of the next picture."""
    while True:
        message = await socket.receive(timeout=20)
        assert message.type in (WSMsgType.TEXT, WSMsgType.BINARY), message
        if message.type is WSMsgType.BINARY:
            (length,) = struct.unpack_from(">I", message.data)
            return json.loads(message.data[4 : 4 + length]), message.data[4 + length :]


def test_the_page_comes_with_all_its_parts_and_nothing_from_elsewhere(tmp_path: Path) -> None:
    async def ask() -> None:
        async with Site(tmp_path).client() as client:
            for path, kind in (("/", "html"), ("/view.css", "css"), ("/view.js", "javascript")):
                response = await client.get(path)
                assert response.status == 200
                assert response.content_type == f"text/{kind}"
                assert "default-src 'none'" in response.headers["Content-Security-Policy"]
                assert response.headers["X-Content-Type-Options"] == "nosniff"
            for path in ("/state.py", "/../state.py", "/%2e%2e/state.py", "/page/"):
                assert (await client.get(path)).status == 404

    run(ask)


def test_the_page_names_no_other_site() -> None:
    for path in PAGE.iterdir():
        named = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in named and "https://" not in named


def test_another_name_is_refused_where_only_this_machine_may(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        async with site.client() as client:
            for path in ("/", "/ws"):
                response = await client.get(path, headers={"Host": "evil.example:8080"})
                assert response.status == 403
                assert "localhost" in await response.text()
        assert site.node.watched == []

    run(ask)


@pytest.mark.parametrize("token", [None, TOKEN])
def test_another_sites_page_gets_no_socket(token: str | None, tmp_path: Path) -> None:
    async def ask() -> None:
        async with Site(tmp_path, token).client() as client:
            query = f"/ws?token={token}"
            for origin in ("http://evil.example", "null"):
                with pytest.raises(WSServerHandshakeError) as refused:
                    await client.ws_connect(query, headers={"Origin": origin})
                assert refused.value.status == 403
            own = f"http://{client.host}:{client.port}"
            socket = await client.ws_connect(query, headers={"Origin": own})
            assert (await text(socket, "summary"))["there"] is False

    run(ask)


@pytest.mark.parametrize("query", ["", "?token=", "?token=wrong", f"?token={TOKEN}x"])
def test_without_the_token_nothing_is_shown(query: str, tmp_path: Path) -> None:
    async def ask() -> None:
        async with Site(tmp_path, TOKEN).client() as client:
            for path in ("/", "/view.js", "/ws"):
                response = await client.get(path + query)
                assert response.status == 403
                assert TOKEN not in await response.text()
                assert "Set-Cookie" not in response.headers

    run(ask)


def test_the_token_becomes_a_cookie_and_leaves_the_address(tmp_path: Path) -> None:
    async def ask() -> None:
        async with Site(tmp_path, TOKEN).client() as client:
            response = await client.get(f"/?token={TOKEN}", allow_redirects=False)
            assert (response.status, response.headers["Location"]) == (302, "/")
            cookie = response.headers["Set-Cookie"]
            assert "HttpOnly" in cookie and "SameSite=Lax" in cookie
            named = {"Cookie": cookie.partition(";")[0]}
            # aiohttp's own cookies know no addresses, which is what the test's server has.
            assert (await client.get("/", headers=named)).status == 200
            socket = await client.ws_connect("/ws", headers=named)
            assert (await text(socket, "summary"))["node"] == ""

    run(ask)


def test_all_that_is_known_is_told_at_first_and_then_what_is_new(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        site.state.tell_status(Status("/turbseg", "ok", "segmenting", {"turbulence (px)": "0.4"}))
        site.state.tell_parameters([LiveParameter("seed.size", "int", 9, "Side", 1, 31)])
        async with site.client() as client:
            socket = await client.ws_connect("/ws")
            first = await text(socket, "summary")
            assert (first["node"], first["level"], first["there"]) == ("/turbseg", "ok", True)
            assert first["points"] == [[None, None, None, None, 0.4]]
            (parameter,) = (await text(socket, "parameters"))["parameters"]
            assert (parameter["value"], parameter["maximum"]) == (9, 31)
            assert (await text(socket, "regions"))["regions"] == []
            site.state.tell_status(Status("/turbseg", "warn", "slow", {}))
            while (told := await text(socket, "summary"))["level"] != "warn":
                assert told["points"] == []
            assert told["points"] == [[None] * 5]

    run(ask)


def test_a_picture_comes_with_its_outlines(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        async with site.client() as client:
            socket = await client.ws_connect("/ws")
            site.show(stamp=5)
            header, jpeg = await picture(socket)
            assert jpeg == b"jpeg"
            assert (header["stamp"], header["width"], header["height"]) == (5, 160, 90)
            (found,) = header["objects"]
            assert found["outlines"] == [[[1.0, 2.0], [3.0, 2.0], [3.0, 4.0]]]

    run(ask)


def test_a_slow_browser_gets_the_newest_picture_and_no_backlog(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        async with site.client() as client:
            slow, quick = await client.ws_connect("/ws"), await client.ws_connect("/ws")
            seen = []
            for stamp in range(50):
                site.show(stamp)
                seen.append((await picture(quick))[0]["stamp"])
                await quick.send_json({"kind": "shown"})
            assert seen == list(range(50))
            first, second = [(await picture(slow))[0]["stamp"] for _ in range(2)]
            assert first <= second < 49
            # A summary of later on shows that no picture is under way.
            site.state.tell_status(Status("/turbseg", "ok", "later", {}))
            while True:
                message = await slow.receive(timeout=20)
                assert message.type is WSMsgType.TEXT, "a third picture"
                if json.loads(message.data).get("message") == "later":
                    break
            await slow.send_json({"kind": "shown"})
            assert (await picture(slow))[0]["stamp"] == 49

    run(ask)


def test_images_are_wanted_while_somebody_looks(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        async with site.client() as client:
            one, other = await client.ws_connect("/ws"), await client.ws_connect("/ws")
            await text(other, "summary")
            await one.close()
            await other.close()
            while site.node.watched.count(False) == 0:
                await asyncio.sleep(0.01)
        assert site.node.watched == [True, True, True, False]

    run(ask)


def test_parameters_are_set_and_refusals_told(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        async with site.client() as client:
            socket = await client.ws_connect("/ws")
            for name, problem in (("good", ""), ("bad", "it is bad")):
                await socket.send_json({"kind": "set", "name": name, "value": 3})
                assert await text(socket, "set") == {
                    "kind": "set",
                    "name": name,
                    "problem": problem,
                }
        assert site.node.set == [("good", 3), ("bad", 3)]

    run(ask)


def test_a_node_that_does_not_answer_is_said_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("turbseg_ros.view.server._SET_LIMIT", 0.1)

    async def ask() -> None:
        async with Site(tmp_path).client() as client:
            socket = await client.ws_connect("/ws")
            await socket.send_json({"kind": "set", "name": "silent", "value": 3})
            assert (await text(socket, "set"))["problem"] == "the node does not answer"

    run(ask)


def test_pictures_go_on_while_the_node_does_not_answer(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        async with site.client() as client:
            socket = await client.ws_connect("/ws")
            await socket.send_json({"kind": "set", "name": "silent", "value": 3})
            for stamp in range(5):
                site.show(stamp)
                assert (await picture(socket))[0]["stamp"] == stamp
                await socket.send_json({"kind": "shown"})
            await socket.send_json({"kind": "set", "name": "good", "value": 3})
            assert (await text(socket, "set"))["name"] == "good"

    run(ask)


def test_regions_are_saved_and_shown_to_everybody(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        site.show(stamp=1)
        async with site.client() as client:
            one, other = await client.ws_connect("/ws"), await client.ws_connect("/ws")
            assert (await text(other, "regions"))["regions"] == []
            await one.send_json({"kind": "save", "regions": [ROAD]})
            saved = await text(one, "saved")
            assert saved["problem"] == "" and "regions.yaml" in saved["done"]
            assert (await text(other, "regions"))["regions"] == [ROAD]
        assert "image_size: [160, 90]" in site.file.path.read_text()

    run(ask)


def test_a_node_that_takes_regions_live_is_told_their_file(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path)
        path = str(site.file.path.resolve())
        async with site.client() as client:
            socket = await client.ws_connect("/ws")
            for value in ("", path):  # the second time, it has that file already
                site.state.tell_parameters([LiveParameter("regions.file", "str", value)])
                await socket.send_json({"kind": "save", "regions": [ROAD]})
                assert (await text(socket, "saved"))["done"].endswith("the node has taken it")
        assert site.node.set == [("regions.file", path)] * 2

    run(ask)


def test_regions_that_can_not_be_saved_are_said_to(tmp_path: Path) -> None:
    async def ask() -> None:
        site = Site(tmp_path / "nowhere")
        async with site.client() as client:
            socket = await client.ws_connect("/ws")
            for regions, problem in (
                ([{**ROAD, "kind": "x"}], "kind is one"),
                ([ROAD], "nowhere"),
            ):
                await socket.send_json({"kind": "save", "regions": regions})
                told = (await text(socket, "saved"))["problem"]
                assert told.startswith("not saved: ") and problem in told

    run(ask)


@pytest.mark.parametrize(
    "nonsense", ["", "3", "[]", '"kind"', "{}", '{"kind": 3}', '{"kind": "set"}', "\x00{"]
)
def test_nonsense_is_no_harm(nonsense: str, tmp_path: Path) -> None:
    async def ask() -> None:
        async with Site(tmp_path).client() as client:
            socket = await client.ws_connect("/ws")
            await socket.send_str(nonsense)
            await socket.send_bytes(b"\xff")
            await socket.send_json({"kind": "set", "name": "good", "value": 1})
            while (await text(socket, "set"))["name"] != "good":
                pass

    run(ask)


def test_no_more_browsers_than_can_be_served_are_let_in(tmp_path: Path) -> None:
    async def ask() -> None:
        async with Site(tmp_path).client() as client:
            sockets = [await client.ws_connect("/ws") for _ in range(16)]
            with pytest.raises(WSServerHandshakeError) as refused:
                await client.ws_connect("/ws")
            assert refused.value.status == 503
            await sockets[0].close()

    run(ask)


def test_the_end_is_told_to_browsers(tmp_path: Path) -> None:
    async def ask() -> None:
        async with Site(tmp_path).client() as client:
            socket = await client.ws_connect("/ws")
            await text(socket, "summary")
            await client.server.close()
            while (message := await socket.receive(timeout=20)).type is WSMsgType.TEXT:
                pass
            assert message.type is WSMsgType.CLOSE

    run(ask)


@pytest.mark.parametrize(
    ("host", "token", "address"),
    [
        ("localhost", None, "http://localhost:8080/"),
        ("::1", None, "http://[::1]:8080/"),
        ("192.0.2.1", "a/b", "http://192.0.2.1:8080/?token=a%2Fb"),
    ],
)
def test_the_address_is_one_to_open(host: str, token: str | None, address: str) -> None:
    assert page_address(host, 8080, token) == address
