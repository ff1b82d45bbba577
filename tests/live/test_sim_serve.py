"""`tutti sim serve`: simulated controllers alone, reached by plain sockets and pseudo-terminals."""

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from children import LIMIT_S
from fleet import COMMAND, EXAMPLES, free_port, run_tutti

from orchestrator.model.jobs.files import load_fleet

pytestmark = pytest.mark.live


@contextmanager
def serving(*arguments: str) -> "Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]":
    """The command, with what it has printed when all listen; it is ended by Ctrl-C, with exit code 0."""
    process = subprocess.Popen([*COMMAND, "sim", "serve", *arguments, "--json"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        lines: list[str] = []
        while not lines or lines[-1].rstrip() not in ("}", ""):
            lines.append(process.stdout.readline())
        yield process, json.loads("".join(lines))
        process.send_signal(signal.SIGINT)
        assert process.wait(LIMIT_S) == 0
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def exchange(device: str, sent: bytes, end: bytes) -> bytes:
    """Write to a pseudo-terminal, and read until `end`."""
    port = os.open(device, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(port)
        os.write(port, sent)
        reply, give_up_s = b"", time.monotonic() + LIMIT_S
        while end not in reply:
            assert select.select([port], [], [], max(0.0, give_up_s - time.monotonic()))[0], reply
            reply += os.read(port, 1024)
        return reply
    finally:
        os.close(port)


def test_the_example_driver_moves_a_served_controller_and_sees_its_limit_and_truth() -> None:
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        [sys.executable, EXAMPLES / "own_driver.py"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=3 * LIMIT_S,
    )
    assert done.returncode == 0, done.stderr
    assert "moved to 2000" in done.stdout and "BGX is refused; its error code: 22" in done.stdout
    truth = [json.loads(line.partition(" ")[2]) for line in done.stdout.splitlines() if line.startswith("truth:")]
    assert [each["event"] for each in truth] == ["start", "end"] and truth[1]["end_counts"] == 2000


def test_a_fleet_file_is_served_on_sockets_serial_lines_and_a_can_bus(tmp_path: Path) -> None:
    first, file = free_port(), tmp_path / "some.fleet.yaml"
    plain = load_fleet(EXAMPLES / "all.fleet.yaml").to_plain()
    some = {name: plain["controllers"][name] for name in ("gantry", "stage", "arm")}
    file.write_text(json.dumps({"schema": "tutti.fleet/1", "fleet": "some", "controllers": some}))
    arguments = ("--fleet", str(file), "--state", str(tmp_path), "--port", str(first))
    with serving(*arguments) as (process, served):
        links = {link["controllers"][0]["name"]: link for link in served["links"]}
        assert links["gantry"]["port"] == first and links["gantry"]["controllers"][0]["motors"] == ["X", "Y"]
        with socket.create_connection(("127.0.0.1", first), timeout=LIMIT_S) as gantry:
            gantry.sendall(b"TPX\r")
            assert gantry.recv(100).strip().endswith(b":")
        assert exchange(links["arm"]["channel"], b"V\r", b"\r") == b"V1010\r"
        assert exchange(links["stage"]["device"], b"*IDN?\r\n", b"\n")
        again = run_tutti("sim", "serve", *arguments)
        assert again.returncode == 1 and "uses" in again.stderr and "--state" in again.stderr
        pushed = run_tutti("sim", "power", "gantry", "off", "--state", str(tmp_path))
        assert pushed.returncode == 0 and "gantry is switched off" in pushed.stdout
        assert process.poll() is None


def test_a_port_that_is_taken_is_named(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = run_tutti("sim", "serve", "smc4000", "--port", str(port), "--state", str(tmp_path))
    assert done.returncode == 1 and f"port {port} of 127.0.0.1 is in use; choose another one" in done.stderr
