"""`tutti up` names what is not reached; `tutti down` finds the fleet that it ends, and nothing else."""

import asyncio
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from click.testing import CliRunner
from cluster.worlds import demo_fleet
from unit.cli.command_world import open_world

from orchestrator.bus.logfile import MAX_LOG_BYTES
from orchestrator.cli.machine.up import _start_and_reach
from orchestrator.cli.main import main
from orchestrator.model.files.private_files import open_for_append
from orchestrator.runtime.live import fleet as live
from orchestrator.runtime.live.fleet import LiveFleet
from orchestrator.runtime.state.folder import (
    UP_LOG,
    StateLock,
    UpFailed,
    find_running_fleet,
    find_running_fleets,
    find_start_ticks,
)


class FakeLive:
    """A fleet with a controller that nothing serves, beside those of the virtual one."""

    def __init__(self, *controllers: str) -> None:
        self.fleet = SimpleNamespace(fleet="demo", controllers=dict.fromkeys(controllers))
        self.connect = "tcp/127.0.0.1:1"
        self.closed = False

    async def start(self) -> None:
        return None

    async def close(self) -> None:
        self.closed = True


def test_controllers_that_are_not_reached_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for world in open_world(monkeypatch):
        live = FakeLive("gantry", "stage", "feeder")
        assert world.wait(_start_and_reach(cast(LiveFleet, live), 3.0, required=False)) == ["feeder"]
        assert not live.closed
        with pytest.raises(UpFailed, match=r"not reached within 3 s: feeder: no adapter answers"):
            world.wait(_start_and_reach(cast(LiveFleet, live), 3.0, required=True))
        assert live.closed
        assert world.wait(_start_and_reach(cast(LiveFleet, FakeLive("gantry", "stage")), 60.0, required=True)) == []


def test_a_state_folder_names_the_process_that_holds_it(tmp_path: Path) -> None:
    assert find_running_fleet(tmp_path) is None
    lock = StateLock(tmp_path)
    assert find_running_fleet(tmp_path) is None
    lock.describe_fleet("demo", "tcp/127.0.0.1:7447")
    found = find_running_fleet(tmp_path)
    assert found is not None
    assert (found.pid, found.fleet, found.connect) == (os.getpid(), "demo", "tcp/127.0.0.1:7447")
    with pytest.raises(UpFailed, match="another `tutti up` uses"):
        StateLock(tmp_path)
    assert find_running_fleet(tmp_path) == found
    lock.release()
    lock.release()
    assert find_running_fleet(tmp_path) is None
    StateLock(tmp_path).release()


@pytest.mark.parametrize(
    "left",
    ["", "{", "[]", "null", '{"pid": 1}', '{"pid": %d, "started": 1, "fleet": "f", "connect": "c", "host": "h"}'],
)
def test_what_a_killed_process_has_left_names_no_living_one(tmp_path: Path, left: str) -> None:
    (tmp_path / "lock").write_text(left.replace("%d", str(os.getpid())))
    assert find_running_fleet(tmp_path) is None


def test_a_process_is_known_by_its_id_and_its_start() -> None:
    assert find_start_ticks(os.getpid()) == find_start_ticks(os.getpid()) is not None
    assert find_start_ticks(2**22 + 1) is None


def test_down_ends_only_what_it_can_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    sent: list[Any] = []
    monkeypatch.setattr("signal.pidfd_send_signal", lambda *call: sent.append(call))

    def down(*words: str) -> tuple[int, str]:
        result = CliRunner().invoke(main, ["down", *words], prog_name="tutti")
        return result.exit_code, result.output

    assert down()[0] == 3
    assert down("--state", str(tmp_path))[0] == 3
    locks = {name: StateLock(tmp_path / "tutti" / name) for name in ("one", "two")}
    for name, lock in locks.items():
        lock.describe_fleet(name, "tcp/127.0.0.1:1")
    assert [each.fleet for each in find_running_fleets()] == ["one", "two"]
    code, said = down()
    assert code == 2 and "several fleets run: one, two" in said
    code, said = down("--fleet", "three")
    assert code == 3 and "no fleet three runs" in said and "there run: one, two" in said
    assert sent == []
    for lock in locks.values():
        lock.release()


def test_what_children_write_to_standard_error_is_limited_while_they_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "ROTATE_S", 0.0)
    fleet = LiveFleet(demo_fleet(), tmp_path, lambda _: None)
    logs = [tmp_path / "log" / name for name in ("router.err", UP_LOG)]
    for log in logs:
        os.close(open_for_append(log))
        os.truncate(log, MAX_LOG_BYTES)

    async def rotate_until_small() -> None:
        rotating = asyncio.create_task(fleet._rotate_logs())
        async with asyncio.timeout(30.0):
            while any(log.stat().st_size for log in logs):
                await asyncio.sleep(0.001)
        rotating.cancel()

    asyncio.run(rotate_until_small())
    assert all(log.with_name(f"{log.name}.1").stat().st_size == MAX_LOG_BYTES for log in logs)
