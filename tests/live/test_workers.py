"""Work spread over real processes."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from children import wait_until
from click.testing import CliRunner

from benches.__main__ import main as benches
from orchestrator.runtime.workers import map_in_processes

pytestmark = pytest.mark.live


def test_results_come_in_the_order_of_the_items() -> None:
    assert (
        list(map_in_processes(abs, [-3, 1, -2], processes=2)) == list(map_in_processes(abs, [-3, 1, -2])) == [3, 1, 2]
    )


def test_an_error_of_one_item_is_raised_and_ends_the_rest() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        list(map_in_processes(int, ["1", "nonsense", *["2"] * 1000], processes=2))


def test_two_processes_measure_what_one_does() -> None:
    asked = ["sync", "--trials", "5", "--only", "^2 SMC-4000, clock, align 10 s", "--history", "5", "--json"]
    alone, both = [CliRunner().invoke(benches, [*asked, "--processes", n]) for n in ("1", "2")]
    assert alone.exit_code == both.exit_code == 0, both.output
    assert json.loads(both.stdout) == json.loads(alone.stdout)
    assert len(json.loads(alone.stdout)["rows"]) == 1


def test_workers_end_with_their_parent() -> None:
    code = "from orchestrator.runtime.workers import map_in_processes; from time import sleep\n"
    code += "if __name__ == '__main__':\n for k in map_in_processes(sleep, [0, 0, 600, 600], 2): print(k, flush=True)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() and parent.stdout.readline()
        workers = [int(pid) for pid in Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()]
        assert len(workers) >= 2
        parent.kill()
    try:
        wait_until(lambda: not any(runs(pid) for pid in workers), "the end of the workers")
    finally:
        for pid in filter(runs, workers):
            os.kill(pid, signal.SIGKILL)


def runs(pid: int) -> bool:
    """Whether a process exists, and not merely its entry that has not been reaped."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
