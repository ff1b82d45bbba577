"""The command of `notify` as a real process: its input, its end, and one that hangs with a child of its own."""

import asyncio
import os
from pathlib import Path

import pytest
from children import wait_until  # type: ignore[import-not-found]

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.alarms.command_process import run_command_process
from orchestrator.coordinator.leadership.environment import CommandResult

pytestmark = pytest.mark.live


def run(script: str, text: bytes = b"{}", timeout_ns: int = 20 * NS_PER_S) -> CommandResult:
    variables = {"TUTTI_ALARM_ID": "estop-fleet"}
    return asyncio.run(run_command_process(["sh", "-c", script], text, variables, timeout_ns))


def test_a_command_gets_the_alarm_and_ends_or_is_killed_with_its_children(tmp_path: Path) -> None:
    said = tmp_path / "said"
    assert run(f'cat > {said}; echo " $TUTTI_ALARM_ID" >> {said}', b'{"id": 1}') == CommandResult(0, "")
    assert said.read_text() == '{"id": 1} estop-fleet\n'
    assert run("echo no line >&2; exit 3") == CommandResult(3, "no line")
    # It may print as much as it likes, and read nothing.
    code, why = run("head -c 3000000 /dev/zero | tr '\\0' x >&2; yes | head -c 3000000", b"x" * 9000)
    assert (code, len(why)) == (0, 500)
    missing = asyncio.run(run_command_process(["/no/such/command"], b"{}", {}, NS_PER_S))
    assert missing == CommandResult(None, "/no/such/command: No such file or directory")
    # A child that keeps the output open does not keep the coordinator.
    child = tmp_path / "child"
    assert run(f"sleep 600 & echo $! > {child}; exit 0").exit_code == 0
    os.kill(int(child.read_text()), 9)
    hung = run(f"trap '' TERM; sleep 600 & echo $! > {child}; wait; sleep 600", timeout_ns=500 * NS_PER_MS)
    assert hung == CommandResult(None, "killed after 0.5 s")
    pid = int(child.read_text())
    wait_until(lambda: not is_running(pid), "its child is dead too")


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
