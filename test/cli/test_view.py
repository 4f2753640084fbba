"""`turbseg_view` as its user starts it: what it prints, what it refuses, how it ends."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("aiohttp", reason="aiohttp is not installed")

from turbseg_ros.cli.view import main

Start = Callable[..., "tuple[subprocess.Popen[str], str]"]

TIME_LIMIT = 60


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Return a function that starts the viewer and gives it with the address that it prints."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> tuple[subprocess.Popen[str], str]:
        command = [sys.executable, "-m", "turbseg_ros.cli", "view", "--port", "0", *arguments]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
        )
        started.append(process)
        assert process.stdout is not None
        found = re.search(r"open (http://\S+)", process.stdout.readline())
        assert found
        return process, found[1]

    yield start
    for process in started:
        process.kill()
        process.communicate(timeout=TIME_LIMIT)


def status_of(address: str) -> int:
    try:
        with urllib.request.urlopen(address, timeout=TIME_LIMIT) as response:
            return int(response.status)
    except urllib.error.HTTPError as error:
        return error.code


def listens_at(address: str) -> str:
    return address.partition("//")[2].partition("/")[0].rpartition(":")[0]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_this_machine_until_a_signal_ends_it_well(
    number: signal.Signals, start: Start, tmp_path: Path
) -> None:
    process, address = start()
    assert listens_at(address) == "localhost" and "token" not in address
    assert status_of(address) == 200
    process.send_signal(number)
    _, errors = process.communicate(timeout=TIME_LIMIT)
    assert (process.returncode, errors) == (0, "")
    assert list(tmp_path.iterdir()) == []


def test_a_page_for_other_machines_asks_for_the_token_that_is_printed(start: Start) -> None:
    _, address = start("--host", "0.0.0.0")
    page, _, token = address.partition("?token=")
    assert len(token) >= 32
    local = f"http://127.0.0.1:{page.rstrip('/').rpartition(':')[2]}/"
    assert status_of(local) == 403
    assert status_of(f"{local}?token={token[:-1]}") == 403
    # The page itself comes to whoever keeps the cookie.
    keeping = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with keeping.open(f"{local}?token={token}", timeout=TIME_LIMIT) as response:
        assert response.status == 200 and "token" not in response.url


def test_each_start_has_another_token(start: Start) -> None:
    tokens = {start("--host", "0.0.0.0")[1].partition("?token=")[2] for _ in range(2)}
    assert len(tokens) == 2


def test_a_port_that_is_taken_is_said_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(["--port", str(port)]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert f"localhost:{port}" in line and "--port" in line


@pytest.mark.parametrize(
    "arguments",
    [
        ("--host", "192.0.2.1"),
        ("--host", "no such name"),
        ("--host", "::zz"),
        ("--port", "0", "--node", "bad name!"),
        ("--port", "0", "--ros-args", "-r", "nonsense"),
    ],
)
def test_what_can_not_be_is_said_in_one_line(
    arguments: tuple[str, ...], capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(list(arguments)) == 2
    lines = capfd.readouterr().err.splitlines()
    assert [line for line in lines if line.startswith("turbseg_view: ")] == lines[-1:]


@pytest.mark.parametrize("port", ["-1", "65536", "http"])
def test_a_port_is_a_number_that_ports_have(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        main([f"--port={port}"])
    assert refused.value.code == 2
    assert "--port" in capsys.readouterr().err


def test_it_does_not_hang_on_a_browser_that_never_reads(start: Start) -> None:
    process, address = start()
    host, port = address.removeprefix("http://").rstrip("/").split(":")
    with socket.create_connection((host, int(port)), TIME_LIMIT) as silent:
        silent.sendall(
            f"GET /ws HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        assert b"101" in silent.recv(100)
        process.send_signal(signal.SIGINT)
        began = time.monotonic()
        assert process.wait(TIME_LIMIT) == 0
        assert time.monotonic() - began < 30
