"""`tutti estop --armed` as a process: a line on its standard input stops the fleet; it survives the router."""

import json
import os
import queue
import threading
from pathlib import Path

import pytest
from children import LIMIT_S
from fleet import COMMAND, RunningFleet, run_tutti
from forks import ForkedProcess

pytestmark = pytest.mark.live


class ArmedProcess:
    """The command, and the kinds of the lines that it prints."""

    def __init__(self, *options: str) -> None:
        self.process = ForkedProcess([*COMMAND[1:], "estop", "--armed", "--json", *options], os.environ)
        self._lines: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join(LIMIT_S)
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()

    def wait_for(self, kind: str) -> str:
        """The text of the next line of this kind."""
        while True:
            line = json.loads(self._lines.get(timeout=LIMIT_S))
            if line["kind"] == kind:
                return line["text"]

    def say(self, text: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(text)
        self.process.stdin.flush()


def test_a_line_on_standard_input_or_a_port_latches_the_fleet(shared: RunningFleet) -> None:
    shared.works()
    master, slave = os.openpty()
    armed = ArmedProcess("--connect", shared.endpoint, "--port", os.ttyname(slave))
    try:
        assert "no safety function" in armed.wait_for("safety")
        assert "demo/gantry" in armed.wait_for("armed")
        armed.say("stop\n")
        armed.wait_for("sent")
        armed.wait_for("latched")
        shared.ask(lambda tutti: tutti.reset())
        os.write(master, b"B\r\n")
        armed.wait_for("latched")
        shared.ask(lambda tutti: tutti.reset())
        armed.process.terminate()
        armed.wait_for("disarmed")
        assert armed.process.wait(LIMIT_S) == 0
    finally:
        armed.close()
        os.close(master)
        os.close(slave)


def test_it_is_loud_without_a_router_and_ends_with_its_input(tmp_path: Path) -> None:
    armed = ArmedProcess("--connect", "tcp/127.0.0.1:9")
    try:
        assert "use the wired e-stop" in armed.wait_for("not-connected")
        armed.say("now\n")
        armed.wait_for("not-sent")
        assert armed.process.stdin is not None
        armed.process.stdin.close()
        assert armed.process.wait(LIMIT_S) == 1
    finally:
        armed.close()
    refused = run_tutti("estop", "--armed")
    assert refused.returncode == 1 and "must be a terminal or a pipe" in refused.stderr
