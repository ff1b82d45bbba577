"""Child processes of live tests, always cleaned up."""

import json
import os
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from forks import ForkedProcess

LIMIT_S = 30.0
"""Generous: an event that takes longer does not occur."""

HERE = Path(__file__).parent


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait for an effect of another process; there is no event to wait for."""
    give_up_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < give_up_s, f"not within {LIMIT_S} s: {what}"
        time.sleep(0.005)


class Children:
    """Starts processes, and ends them with the test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._stack = ExitStack()
        self._environment = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{HERE}"}
        entries = folder / "fakemake-1.dist-info"
        entries.mkdir()
        (entries / "METADATA").write_text("Metadata-Version: 2.1\nName: fakemake\nVersion: 1\n")
        (entries / "entry_points.txt").write_text("[tutti.adapters]\nfake = fake_make:MAKE\n")

    def start(self, *arguments: str) -> ForkedProcess:
        """`python -m` with `arguments`; its ready line is not read yet."""
        process = ForkedProcess(["-m", *arguments], self._environment)
        self._stack.callback(self._end, process)
        return process

    def simulator(self, model: str, listen: str, *more: str) -> tuple[ForkedProcess, dict[str, Any]]:
        """A simulated controller that can be reached, and where."""
        process = self.start("sim.link.process", "--model", model, "--name", "unit", "--listen", listen, *more)
        return process, json.loads(ready(process))

    def close(self) -> None:
        self._stack.close()

    def _end(self, process: ForkedProcess) -> None:
        if process.poll() is None:
            process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for pipe in (process.stdin, process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()


def ready(process: ForkedProcess) -> str:
    """The first line that the process prints."""
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        assert process.stderr is not None
        raise AssertionError(f"ended with {process.wait()}: {process.stderr.read()}")
    return line.strip()


def tell(process: ForkedProcess, **change: object) -> None:
    """Change the world of a simulator."""
    assert process.stdin is not None
    process.stdin.write(json.dumps(change) + "\n")
    process.stdin.flush()
