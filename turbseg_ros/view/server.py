"""The web server: the page, and a WebSocket for all that changes.

To the page go texts (JSON, by their `kind`) and pictures: binary, a JSON text's length in four
bytes, that text, a JPEG. The page says `shown` after each picture, and gets no further one while
two are on their way: who is slow sees fewer pictures, and none late.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlencode

from aiohttp import WSCloseCode, WSMsgType, web

from turbseg_ros.parameters import ParameterError
from turbseg_ros.view.access import Access
from turbseg_ros.view.regions import Region, RegionFile
from turbseg_ros.view.state import DRAWN, Picture, ViewState

_PAGE = Path(__file__).parent / "page"
_FILES = {
    "/": ("index.html", "text/html"),
    "/view.css": ("view.css", "text/css"),
    "/view.js": ("view.js", "text/javascript"),
}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
_MAX_CLIENTS = 16
# Bytes that the page may send at once: regions with many corners.
_MAX_MESSAGE = 1 << 20
_UNDER_WAY = 2
# Parameters and regions of one browser that are being set; it waits with further ones.
_MAX_WISHES = 16
# Seconds.
_SUMMARY_PERIOD = 0.5
_HEARTBEAT = 20.0
_SET_LIMIT = 5.0
# The node's parameter that names a file of regions, where it has one.
_REGION_PARAMETER = "regions.file"


class Node(Protocol):
    """What the page may ask of the node that it looks at."""

    def watch(self, watched: bool) -> None:
        """Say whether somebody looks at pictures."""

    def set_parameter(self, name: str, value: object) -> Future[str]:
        """Change a parameter; the future gives the reason why not, "" when it has changed."""


@dataclass(eq=False)
class _Client:
    """One browser: what it has been told, and what it waits for."""

    socket: web.WebSocketResponse
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    points: int = 0
    parameters: int = -1
    regions: int = -1
    picture: int = 0
    under_way: int = 0
    summary_due: float = 0.0
    wishes: set[asyncio.Task[None]] = field(default_factory=set)


class ViewServer:
    """Serves what `state` tells, to whom `access` admits, and hands their wishes to `node`.

    `port` names the cookie, for browsers tell those of two ports of a machine not apart.
    """

    def __init__(
        self, state: ViewState, node: Node, access: Access, regions: RegionFile, port: int = 0
    ) -> None:
        self._state, self._node, self._access = state, node, access
        self._file = regions
        self._regions: list[Region] = []
        self._regions_problem = ""
        self._region_version = 0
        self._cookie = f"turbseg_view_{port}"
        self._clients: set[_Client] = set()
        self._read_regions()

    def application(self) -> web.Application:
        """Return what aiohttp runs."""
        application = web.Application(middlewares=[self._admit])
        for path in _FILES:
            application.router.add_get(path, self._file_response)
        application.router.add_get("/ws", self._talk)
        application.cleanup_ctx.append(self._follow)
        application.on_shutdown.append(self._say_goodbye)
        return application

    @web.middleware
    async def _admit(
        self,
        request: web.Request,
        handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
    ) -> web.StreamResponse:
        host = request.headers.get("Host", "")
        if not self._access.takes_host(host):
            return _refused("turbseg_view listens to this machine by its own name only: localhost")
        asked = request.query.get("token")
        if not self._access.admits(asked or request.cookies.get(self._cookie)):
            return _refused("open the address that turbseg_view printed, with its token")
        if asked is not None and request.path == "/":
            # Out of the address, so that it is in no history and on no screen.
            response = web.Response(status=302, headers={"Location": "/", **_HEADERS})
            response.set_cookie(self._cookie, asked, httponly=True, samesite="Lax")
            return response
        return await handler(request)

    async def _file_response(self, request: web.Request) -> web.StreamResponse:
        name, kind = _FILES[request.path]
        return web.Response(
            body=(_PAGE / name).read_bytes(), content_type=kind, charset="utf-8", headers=_HEADERS
        )

    async def _talk(self, request: web.Request) -> web.StreamResponse:
        if not self._access.takes_origin(
            request.headers.get("Origin"), request.headers.get("Host", "")
        ):
            return _refused("another site's page may not look")
        if len(self._clients) >= _MAX_CLIENTS:
            return web.Response(status=503, text=f"{_MAX_CLIENTS} browsers look already")
        socket = web.WebSocketResponse(
            heartbeat=_HEARTBEAT, max_msg_size=_MAX_MESSAGE, compress=False
        )
        await socket.prepare(request)
        client = _Client(socket)
        self._clients.add(client)
        self._node.watch(True)
        if len(self._clients) == 1:
            self._read_regions()
        sender = asyncio.create_task(self._send(client))
        try:
            await self._listen(client)
        finally:
            self._clients.discard(client)
            self._node.watch(bool(self._clients))
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionError):
                await sender
        return socket

    async def _listen(self, client: _Client) -> None:
        async for message in client.socket:
            if message.type is not WSMsgType.TEXT:
                continue
            try:
                wish = json.loads(message.data)
                kind = wish["kind"]
            except (ValueError, KeyError, TypeError):
                continue
            if kind == "shown":
                client.under_way = max(client.under_way - 1, 0)
                client.changed.set()
            elif kind in ("set", "save"):
                # Pictures go on while the node takes its time.
                if len(client.wishes) >= _MAX_WISHES:
                    await asyncio.wait(client.wishes, return_when=asyncio.FIRST_COMPLETED)
                task = asyncio.create_task(self._fulfil(client, kind, wish))
                client.wishes.add(task)
                task.add_done_callback(client.wishes.discard)

    async def _fulfil(self, client: _Client, kind: str, wish: dict[str, Any]) -> None:
        with contextlib.suppress(ConnectionError):
            if kind == "set":
                name = str(wish.get("name"))
                problem = await self._set(name, wish.get("value"))
                await _tell(client, "set", name=name, problem=problem)
            else:
                problem, done = await self._save(wish.get("regions"))
                await _tell(client, "saved", problem=problem, done=done)

    async def _send(self, client: _Client) -> None:
        """Send whatever is new, each time that something is, and a summary twice a second."""
        try:
            while True:
                client.changed.clear()
                await self._send_news(client)
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(client.changed.wait(), _SUMMARY_PERIOD)
        finally:
            # The page connects anew, whatever it was.
            await client.socket.close()

    async def _send_news(self, client: _Client) -> None:
        now = asyncio.get_running_loop().time()
        count, points = self._state.points_since(client.points)
        if points or now >= client.summary_due:
            client.points, client.summary_due = count, now + _SUMMARY_PERIOD
            await _tell(
                client, "summary", **self._state.summary(), points=points, point_names=DRAWN
            )
        version, parameters = self._state.parameters
        if version != client.parameters:
            client.parameters = version
            await _tell(client, "parameters", parameters=[asdict(each) for each in parameters])
        if self._region_version != client.regions:
            client.regions = self._region_version
            await _tell(
                client,
                "regions",
                regions=self._regions,
                file=str(self._file.path),
                problem=self._regions_problem,
            )
        picture = self._state.picture
        if picture and picture.number > client.picture and client.under_way < _UNDER_WAY:
            client.picture = picture.number
            client.under_way += 1
            await client.socket.send_bytes(packed(picture))

    async def _set(self, name: str, value: object) -> str:
        try:
            return await asyncio.wait_for(
                asyncio.wrap_future(self._node.set_parameter(name, value)), _SET_LIMIT
            )
        except asyncio.TimeoutError:
            return "the node does not answer"

    async def _save(self, regions: object) -> tuple[str, str]:
        """Write the regions, and let the node take them; return what went wrong, and what well."""
        picture = self._state.picture
        size = (picture.width, picture.height) if picture else None
        try:
            self._regions = await asyncio.to_thread(self._file.write, regions, size)
        except ParameterError as error:
            return f"not saved: {error}", ""
        except OSError as error:
            return f"not saved: {self._file.path}: {error.strerror or error}", ""
        self._regions_problem = ""
        self._region_version += 1
        self._wake()
        return await self._hand_over()

    async def _hand_over(self) -> tuple[str, str]:
        path = str(self._file.path.resolve())
        saved = f"saved in {self._file.path}"
        _, parameters = self._state.parameters
        if _REGION_PARAMETER not in {each.name for each in parameters}:
            return "", f"{saved}; the node takes it when it starts with {_REGION_PARAMETER}"
        # The same name again has the file read anew.
        if problem := await self._set(_REGION_PARAMETER, path):
            return f"{saved}, but the node refuses it: {problem}", ""
        return "", f"{saved}; the node has taken it"

    def _read_regions(self) -> None:
        try:
            self._regions, self._regions_problem = self._file.read(), ""
        except ParameterError as error:
            self._regions, self._regions_problem = [], str(error)
        self._region_version += 1

    async def _follow(self, _application: web.Application) -> AsyncIterator[None]:
        """Wake the senders, in the loop's thread, whenever the state changes."""
        loop = asyncio.get_running_loop()

        def wake() -> None:
            # What changes while the loop ends is of no interest any more.
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(self._wake)

        self._state.on_change = wake
        yield
        self._state.on_change = lambda: None

    def _wake(self) -> None:
        for client in self._clients:
            client.changed.set()

    async def _say_goodbye(self, _application: web.Application) -> None:
        for client in list(self._clients):
            await client.socket.close(code=WSCloseCode.GOING_AWAY, message=b"turbseg_view ends")


def packed(picture: Picture) -> bytes:
    """Return a picture as the page gets it."""
    header = {
        "number": picture.number,
        "stamp": picture.result.stamp,
        "width": picture.width,
        "height": picture.height,
        "drawn": picture.drawn,
        "objects": [
            {"id": each.id, "colour": each.colour, "outlines": each.outlines, "trail": each.trail}
            for each in picture.result.objects
        ],
    }
    text = json.dumps(header, separators=(",", ":")).encode()
    return struct.pack(">I", len(text)) + text + picture.jpeg


def page_address(host: str, port: int, token: str | None) -> str:
    """Return what to open in a browser."""
    shown = f"[{host}]" if ":" in host else host
    query = "?" + urlencode({"token": token}) if token else ""
    return f"http://{shown}:{port}/{query}"


async def _tell(client: _Client, kind: str, **content: Any) -> None:
    await client.socket.send_str(json.dumps({"kind": kind, **content}, separators=(",", ":")))


def _refused(reason: str) -> web.Response:
    return web.Response(status=403, text=f"{reason}\n", headers=_HEADERS)
