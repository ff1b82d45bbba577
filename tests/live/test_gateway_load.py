"""The gateway under slow and many connections: a stop by HTTP gets through, and none of them stays.

The limits here are generous, for a busy machine; figures of a quiet one are in docs/explanation/security.md.
"""

import contextlib
import http.client
import json
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import pytest
from children import LIMIT_S
from fleet import RunningFleet, free_port

from orchestrator.gateway.access.users import StoredToken, UserFile
from orchestrator.gateway.connections import MAX_NOT_SIGNED_IN

pytestmark = pytest.mark.live

STOP_S = 1.5  # 0.3 s on a quiet machine
GAP_S = 1.0  # between two turns of the gateway; 0.15 s on a quiet machine
CHECK_S = 300.0
UTC, LATER = "2026-01-01T00:00:00.000000Z", "2999-01-01T00:00:00.000000Z"
LENGTH = 3_900_000


@dataclass
class Door:
    """A gateway with users. token: of an operator."""

    port: int
    token: str
    pid: int

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    def measure_stop(self) -> float:
        """How long a stop on a new connection takes, in s."""
        begun_s = time.monotonic()
        request = Request(f"http://{self.host}/v1/stop", b"{}", {"content-type": "application/json"})
        request.add_header("authorization", f"Bearer {self.token}")
        with urlopen(request, timeout=LIMIT_S) as answer:
            assert set(json.loads(answer.read())["answers"]) == {"gantry", "stage"}
        return time.monotonic() - begun_s

    def open_link(self, stack: ExitStack, data: bytes = b"") -> socket.socket:
        """A connection that sends `data`, and no more."""
        link = stack.enter_context(closing(socket.create_connection(("127.0.0.1", self.port), LIMIT_S)))
        link.sendall(data)
        return link

    def make_head(self, path: str, length: int, *, token: bool) -> bytes:
        lines = [f"POST {path} HTTP/1.1", f"Host: {self.host}", f"Content-Length: {length}"]
        lines += ["Content-Type: application/json", *([f"Authorization: Bearer {self.token}"] if token else [])]
        return "\r\n".join([*lines, "", ""]).encode()

    def measure_memory(self) -> int:
        """Its resident memory, in kB."""
        status = Path(f"/proc/{self.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0])


def is_open(link: socket.socket) -> bool:
    link.setblocking(False)
    try:
        return link.recv(65_536) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


def receive_status(link: socket.socket) -> str:
    """The status of the answer; empty if the connection has ended without one."""
    try:
        return link.recv(100).decode("latin-1")[9:12]
    except ConnectionError:
        return ""


@pytest.fixture(scope="module")
def door(demo_fleet: RunningFleet, tmp_path_factory: pytest.TempPathFactory) -> Generator[Door]:
    state, port = tmp_path_factory.mktemp("door"), free_port()
    users = UserFile(state / "users.json")
    users.add_user("olga", "operator", "", UTC)
    stored = StoredToken(digest="", role="operator", created_utc=UTC, expires_utc=LATER)
    token = users.add_token("olga", "ci", stored, "secret" * 8)
    arguments = ["--fleet", "demo", "--connect", demo_fleet.endpoint, "--state", str(state), "--port", str(port)]
    command = [sys.executable, "-m", "orchestrator.gateway.process", *arguments, "--log", str(state / "log")]
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline().startswith("page on ")
            opened = Door(port, token, process.pid)
            opened.measure_stop()  # the first one finds the controllers
            yield opened
        finally:
            process.terminate()
            assert process.wait(LIMIT_S) == 0
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.parametrize("count", [320, 1000])
@pytest.mark.parametrize("kind", ["silent", "half a head", "half a sign-in", "half a body"])
def test_a_stop_gets_through_slow_connections(door: Door, kind: str, count: int) -> None:
    data = {
        "silent": b"",
        "half a head": b"POST /v1/login HTTP/1.1\r\nHost",
        "half a sign-in": door.make_head("/v1/login", 10, token=False) + b"{",
        "half a body": door.make_head("/v1/submit", LENGTH, token=True) + b"{",
    }[kind]
    with ExitStack() as stack:
        links = [door.open_link(stack, data) for _ in range(count)]
        stops = [door.measure_stop() for _ in range(3)]
        assert max(stops) < STOP_S
        if kind != "half a body":
            time_s = time.monotonic() + LIMIT_S
            while (left := sum(map(is_open, links))) > MAX_NOT_SIGNED_IN and time.monotonic() < time_s:
                door.measure_stop()
            assert left <= MAX_NOT_SIGNED_IN


def test_unfinished_bodies_take_bounded_memory_and_are_refused(door: Door) -> None:
    memory_kb = door.measure_memory()
    body = b"x" * (LENGTH // 2)
    with ExitStack() as stack:
        links = [door.open_link(stack, door.make_head("/v1/submit", LENGTH, token=True)) for _ in range(100)]
        for link in links:
            with contextlib.suppress(OSError):  # refused before all of it had come
                link.sendall(body)
        assert door.measure_stop() < STOP_S
        assert door.measure_memory() - memory_kb < 200_000
        for link in links:
            link.settimeout(LIMIT_S)
        starts = {receive_status(link) for link in links}
    assert "408" in starts and starts <= {"408", "503", ""}, starts  # "": it gave way to another


def test_a_large_body_is_not_read_before_the_sign_in_is_checked(door: Door) -> None:
    with ExitStack() as stack:
        link = door.open_link(stack, door.make_head("/v1/submit", LENGTH, token=False))
        assert link.recv(100).startswith(b"HTTP/1.1 401 ")
        link = door.open_link(stack, door.make_head("/v1/login", 3000, token=False) + b"x" * 3000)
        assert link.recv(100).startswith(b"HTTP/1.1 413 ")


def test_headers_in_one_piece_are_limited_too(door: Door) -> None:
    for size, start in ((20_000, b"HTTP/1.1 401 "), (33_000, b"HTTP/1.1 400 "), (300_000, b"HTTP/1.1 400 ")):
        with ExitStack() as stack:
            head = f"GET /v1/state HTTP/1.1\r\nHost: {door.host}\r\nX-Long: {'x' * size}\r\n\r\n"
            link = door.open_link(stack)
            with contextlib.suppress(OSError):  # refused before all of it had come
                link.sendall(head.encode())
            assert link.recv(100).startswith(start)


def test_a_connection_goes_on_after_a_body_that_was_not_needed(door: Door) -> None:
    with ExitStack() as stack:
        link = door.open_link(stack, door.make_head("/v1/submit", 10, token=False))
        with closing(link.makefile("rb")) as answers:
            assert b" 401 " in answers.readline()
            link.sendall(b"0123456789" + door.make_head("/v1/stop", 2, token=True) + b"{}")
            while not (line := answers.readline()).rpartition(b"}")[2].startswith(b"HTTP/1.1 "):
                assert line, "the connection has ended"
            assert b"HTTP/1.1 200 " in line


POINTS = [f"X{20 + number // 2 * 0.001:.6f} Y{20 + number % 2 * 0.01:.6f}" for number in range(80_000)]
LINES = [f"G1 {point} ; a piece of {number:08}" for number, point in enumerate(POINTS)]
PATH = """- do: path
  axes: [gantry.x, gantry.y]
  start: [20, 20]
  tolerance: 10 um
  corner: {within: 5 um}
  pieces:
"""
PIECES = "\n".join(f"  - {{piece: line, to: [{20 + number * 0.001:.6f}, 20.00000]}}" for number in range(1, 9_000))
BACK = "  - {piece: line, to: [20, 20]}"
MOVES = "\n".join(
    f"- {{do: move, to: {{gantry.x: {number % 300}, stage.u: {number % 40}}}}}" for number in range(10_000)
)


def _make_program(lines: int) -> dict[str, Any]:
    text = "\n".join(["G21 G90 G64 P0.01 F600", *LINES[:lines], "M2", ""])
    return {"program": {"name": "long.ngc", "text": text}}


CHECKED = {
    "program": _make_program(10_000),
    "longest program": _make_program(len(LINES)),
    "path": {"text": "schema: tutti.job/1\nname: long\nsteps:\n" + 8 * f"{PATH}{PIECES}\n{BACK}\n"},
    "steps": {"text": f"schema: tutti.job/1\nname: many\nsteps:\n{MOVES}\n"},
    "mistakes": {"text": f"schema: tutti.job/1\nname: many\nsteps:\n{MOVES.replace('move', 'mvoe')}\n"},
}


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[pytest.mark.nightly] if kind in ("longest program", "path") else [])
        for kind in CHECKED
    ],
)
def test_a_stop_gets_through_the_check_of_a_long_text(door: Door, kind: str) -> None:
    """A job file or a program of up to 4 MB is read, planned and drawn by another process."""
    body = json.dumps(CHECKED[kind]).encode()
    request = Request(f"http://{door.host}/v1/check-job", body, {"content-type": "application/json"})
    request.add_header("authorization", f"Bearer {door.token}")
    gaps, stops = [0.0], [0.0]

    def check() -> bytes:
        with urlopen(request, timeout=CHECK_S) as answer:
            return answer.read()

    with ThreadPoolExecutor(1) as pool, closing(http.client.HTTPConnection(door.host, timeout=LIMIT_S)) as link:
        checking = pool.submit(check)
        while not checking.done():
            stops.append(door.measure_stop())
            for _ in range(20):
                begun_s = time.monotonic()
                link.request("GET", "/v1/sign-in")
                link.getresponse().read()
                gaps.append(time.monotonic() - begun_s)
    sys.stdout.write(f"{kind}, {len(body)} bytes: longest stop {max(stops):.3f} s, longest gap {max(gaps):.3f} s\n")
    answer: dict[str, Any] = json.loads(checking.result())
    assert (answer["job"] is None) is (kind == "mistakes"), answer["problems"][:2]
    assert max(stops) < STOP_S and max(gaps) < GAP_S
