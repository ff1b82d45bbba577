"""The gateway as a process: its port, its limits, TLS, and what happens to a jog when it is killed."""

import asyncio
import json
import os
import re
import resource
import shutil
import socket
import ssl
import subprocess
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from children import LIMIT_S, wait_until
from fleet import EXAMPLES, RunningFleet, free_port, run_tutti
from forks import run_forked
from websockets.asyncio.client import connect as connect_in_loop
from websockets.sync.client import ClientConnection, connect

pytestmark = pytest.mark.live

JOG_MOST_NS = 700_000_000  # 200 ms and the ramp; the rest for a busy machine
PROCESS = "orchestrator.gateway.process"


def find_page(fleet: RunningFleet) -> str:
    """The address of the page, without the last slash."""
    return re.findall(r"page on (http\S+)/", fleet.output())[0]


def post(url: str, body: Any = None, context: ssl.SSLContext | None = None) -> Any:
    data = json.dumps({} if body is None else body).encode()
    request = Request(url, data, {"content-type": "application/json"})
    with urlopen(request, timeout=LIMIT_S, context=context) as answer:
        return json.loads(answer.read())


def open_socket(page: str) -> ClientConnection:
    return connect(f"ws{page.removeprefix('http')}/v1/stream", max_size=None)


async def stop_over_tls(page: str, context: ssl.SSLContext) -> dict[str, Any]:
    """The answer to a stop. In one thread: the other client reads and writes one TLS object in two, which Python 3.11
    does not protect, and has hung for it."""
    async with (
        asyncio.timeout(LIMIT_S),
        connect_in_loop(f"ws{page.removeprefix('http')}/v1/stream", ssl=context) as link,
    ):
        await link.send(json.dumps({"do": "stop", "id": 1}))
        while (frame := json.loads(await link.recv())).get("answer") != 1:
            pass
        return frame


def ask(stream: ClientConnection, do: str, number: int, **fields: Any) -> dict[str, Any]:
    """Send a frame, and read until its answer."""
    stream.send(json.dumps({"do": do, "id": number, **fields}))
    while (frame := json.loads(stream.recv(timeout=LIMIT_S))).get("answer") != number:
        pass
    return frame


def test_a_jog_ends_when_the_gateway_is_killed_and_it_serves_the_same_address_again(shared: RunningFleet) -> None:
    shared.bring_back()
    page = find_page(shared)
    with open_socket(page) as stream:
        assert "ok" in ask(stream, "acquire", 1, axes=["gantry.x"])
        begun = shared.starts("gantry")
        assert "ok" in ask(stream, "jog", 2, axis="gantry.x", velocity=10)
        number = 3
        while shared.starts("gantry") == begun:  # the simulator writes its truth ten times a second
            assert "ok" in ask(stream, "renew", number)
            number += 1
        killed_ns = shared.kill(PROCESS)
    wait_until(lambda: shared.truth("gantry")[-1]["event"] == "end", "the axis is at rest")
    assert shared.truth("gantry")[-1]["end_ns"] - killed_ns < JOG_MOST_NS

    def answers() -> bool:
        try:
            with urlopen(f"{page}/v1/state", timeout=LIMIT_S) as answer:
                return "gantry" in json.loads(answer.read())["controllers"]
        except OSError:
            return False

    wait_until(answers, "the gateway serves again")


def test_a_thousand_connections_and_one_that_reads_nothing_keep_no_stop(shared: RunningFleet) -> None:
    page = find_page(shared)
    host, port = page.removeprefix("http://").split(":")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    try:
        with ExitStack() as stack, open_socket(page) as stream:
            idle = stack.enter_context(open_socket(page))  # nothing is read of it
            for _ in range(1000):
                stack.enter_context(closing(socket.create_connection((host, int(port)), timeout=LIMIT_S)))
            assert post(f"{page}/v1/stop")["answers"].keys() == {"gantry", "stage"}
            assert "ok" in ask(stream, "stop", 1)
            assert idle.protocol.state.name == "OPEN"
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_body_of_50_mb_is_refused(shared: RunningFleet) -> None:
    page = find_page(shared)
    host, port = page.removeprefix("http://").split(":")
    with closing(socket.create_connection((host, int(port)), timeout=LIMIT_S)) as link:
        head = f"POST /v1/check-job HTTP/1.1\r\nHost: {host}:{port}\r\nContent-Length: 52428800\r\n\r\n"
        link.sendall(head.encode())
        assert link.recv(100).startswith(b"HTTP/1.1 413 ")
    # Without a length, by chunks: no more of it is read than is allowed.
    with closing(socket.create_connection((host, int(port)), timeout=LIMIT_S)) as link:
        head = f"POST /v1/check-job HTTP/1.1\r\nHost: {host}:{port}\r\nTransfer-Encoding: chunked\r\n"
        link.sendall(f"{head}Content-Type: application/json\r\n\r\n".encode())
        sent = 0
        try:
            for _ in range(50):
                link.sendall(b"100000\r\n" + b"x" * 0x100000 + b"\r\n")
                sent += 1
        except OSError:
            pass
        assert sent < 50 or link.recv(100).startswith(b"HTTP/1.1 413 ")


def test_what_comes_from_elsewhere_is_refused(shared: RunningFleet) -> None:
    page = find_page(shared)
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
        with pytest.raises(HTTPError) as refused:
            urlopen(Request(f"{page}/v1/state", headers=headers), timeout=LIMIT_S)
        assert refused.value.code == 403
        assert json.loads(refused.value.read())["refused"]["remedy"]


def test_a_gateway_with_a_certificate_speaks_tls(shared: RunningFleet, tmp_path: Path) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("needs the command openssl, to make a certificate")
    certificate, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    command += ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1", "-out", str(certificate), "-keyout", str(key)]
    subprocess.run(command, check=True, capture_output=True, timeout=LIMIT_S)
    port = free_port()
    arguments = [
        "--fleet",
        "demo",
        "--connect",
        shared.endpoint,
        "--state",
        str(tmp_path),
        "--log",
        str(tmp_path / "log"),
    ]
    arguments += ["--port", str(port), "--ssl-certfile", str(certificate), "--ssl-keyfile", str(key)]
    with subprocess.Popen([sys.executable, "-m", PROCESS, *arguments], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == f"page on https://127.0.0.1:{port}/\n"
            context = ssl.create_default_context(cafile=str(certificate))
            page = f"https://127.0.0.1:{port}"
            assert post(f"{page}/v1/stop", context=context)["answers"].keys() == {"gantry", "stage"}
            assert "ok" in asyncio.run(stop_over_tls(page, context))
            with pytest.raises(OSError):
                urlopen(f"http://127.0.0.1:{port}/v1/state", timeout=LIMIT_S)
        finally:
            process.terminate()
            assert process.wait(LIMIT_S) == 0
    broken = run_forked(["-m", PROCESS, *arguments[:-1], str(certificate)], os.environ, LIMIT_S)
    assert broken.returncode == 2 and "cert.pem cannot be used" in broken.stderr


@pytest.mark.nightly
def test_a_taken_port_keeps_no_fleet_from_starting(tmp_path: Path) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        port = other.getsockname()[1]
        fleet = RunningFleet(tmp_path, EXAMPLES / "demo.fleet.yaml", "--web-port", str(port), web=True)
        try:
            fleet.started()
            assert f"port {port} of 127.0.0.1 is in use; choose another with --web-port" in fleet.output()
        finally:
            fleet.close()


def test_a_taken_port_is_named_with_the_remedy(shared: RunningFleet, tmp_path: Path) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        port = other.getsockname()[1]
        arguments = ["--fleet", "demo", "--connect", shared.endpoint, "--state", str(tmp_path), "--port", str(port)]
        refused = run_forked(["-m", PROCESS, *arguments, "--log", str(tmp_path / "log")], os.environ, LIMIT_S)
    assert refused.returncode == 2
    assert f"port {port} of 127.0.0.1 is in use; choose another with --web-port" in refused.stderr


def test_a_page_for_other_machines_is_refused_with_the_reason() -> None:
    refused = run_tutti("up", str(EXAMPLES / "demo.fleet.yaml"), "--sim", "--web-host", "0.0.0.0")
    assert refused.returncode == 2
    assert "without TLS" in refused.stderr and "add-gateway" in refused.stderr and "ssh -L" in refused.stderr
