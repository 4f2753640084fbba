"""`turbseg_view`: a running node in a browser."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import errno
import secrets
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence

import rclpy
from aiohttp import web
from rclpy.executors import (
    ExternalShutdownException,
    ShutdownException,
    SingleThreadedExecutor,
)
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from turbseg_ros.cli.errors import UsageError, executable
from turbseg_ros.cli.parsers.view import build_parser
from turbseg_ros.view.access import Access, is_local
from turbseg_ros.view.client import Viewer
from turbseg_ros.view.regions import RegionFile
from turbseg_ros.view.server import ViewServer, page_address
from turbseg_ros.view.state import ViewState

_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_ANY_ADDRESS = ("0.0.0.0", "::", "")
_TOKEN_BYTES = 24
# Seconds that browsers get to take note of the end.
_SHUTDOWN_TIMEOUT = 1.0


@executable("turbseg_view")
def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page until SIGINT or SIGTERM, which end it well; return the exit status."""
    command = sys.argv if arguments is None else ["turbseg_view", *arguments]
    try:
        options = build_parser().parse_args(remove_ros_args(command)[1:])
        rclpy.init(args=command, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # ROS arguments that can't be
        raise UsageError(str(error)) from error
    try:
        with _listening(options.host, options.port) as listener:
            return _run(options, listener)
    finally:
        rclpy.try_shutdown()


def _run(options: argparse.Namespace, listener: socket.socket) -> int:
    state = ViewState()
    node = "/" + options.node.strip("/") if options.node else ""
    try:
        viewer = Viewer(state, node_name=node, rate=options.rate, width=options.width)
    except rclpy.exceptions.InvalidTopicNameException as error:
        raise UsageError(f"--node {options.node}: {error}") from error
    executor = SingleThreadedExecutor()
    executor.add_node(viewer)
    try:
        return asyncio.run(_serve(options, listener, state, viewer, executor))
    finally:
        viewer.destroy_node()


async def _serve(
    options: argparse.Namespace,
    listener: socket.socket,
    state: ViewState,
    viewer: Viewer,
    executor: SingleThreadedExecutor,
) -> int:
    loop, stopped = asyncio.get_running_loop(), asyncio.Event()
    for number in _STOP_SIGNALS:
        loop.add_signal_handler(number, stopped.set)
    token = None if is_local(options.host) else secrets.token_urlsafe(_TOKEN_BYTES)
    port = listener.getsockname()[1]
    server = ViewServer(state, viewer, Access(token), RegionFile(options.regions), port)
    runner = web.AppRunner(
        server.application(), access_log=None, shutdown_timeout=_SHUTDOWN_TIMEOUT
    )
    await runner.setup()
    spinner = _Spinner(executor, on_end=lambda: loop.call_soon_threadsafe(stopped.set))
    try:
        await web.SockSite(runner, listener).start()
        spinner.start()
        shown = _own_address() if options.host in _ANY_ADDRESS else options.host
        print(f"turbseg_view: open {page_address(shown, port, token)}", flush=True)
        await stopped.wait()
    finally:
        await runner.cleanup()
        await asyncio.to_thread(spinner.stop)
    return int(spinner.failed)


class _Spinner(threading.Thread):
    """Runs an executor in a thread; `on_end` is called there when it ends, whyever it does."""

    def __init__(self, executor: SingleThreadedExecutor, on_end: Callable[[], object]) -> None:
        super().__init__(name="ros", daemon=True)
        self._executor = executor
        self._on_end = on_end
        self.failed = False

    def run(self) -> None:
        """Spin until `stop`."""
        try:
            with contextlib.suppress(ExternalShutdownException, ShutdownException):
                self._executor.spin()
        except Exception:
            # Without ROS the page would show old things for ever.
            traceback.print_exc()
            self.failed = True
        finally:
            self._on_end()

    def stop(self) -> None:
        """End the executor and wait for the thread."""
        self._executor.create_task(self._executor.shutdown)
        self.join()


def _own_address() -> str:
    """Return the address by which other machines reach this one, or else its name."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outward:
        try:
            # Sends nothing; an address that is kept free for documents (RFC 5737).
            outward.connect(("192.0.2.1", 9))
        except OSError:
            return socket.gethostname()
        return str(outward.getsockname()[0])


@contextlib.contextmanager
def _listening(host: str, port: int) -> Iterator[socket.socket]:
    """Bind a socket for the time of a `with` statement.

    :raises UsageError: when the address is none of this machine's, or the port is taken.
    """
    # Browsers that try ::1 first go on to this one; binding both would make two ports of port 0.
    address = "127.0.0.1" if host == "localhost" else host or "0.0.0.0"
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((address, port))
            listener.listen()
        except OSError as error:
            hint = "; --port takes another" if error.errno == errno.EADDRINUSE else ""
            raise UsageError(
                f"can't listen on {host}:{port}: {error.strerror or error}{hint}"
            ) from error
        listener.setblocking(False)
        yield listener
