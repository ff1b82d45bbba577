"""Standby: a second coordinator on the same journal, which becomes the leader as soon as there is none.

A silent leader is dead or hangs. One that hangs may hold the journal in the middle of a transaction, and would
continue with outdated state when it resumes. Its epoch is over then and no adapter accepts it, but the journal would
stay locked; so the standby kills it first. A file beside the journal names the leader's process.
"""

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusSample
from orchestrator.bus.keys import STANDBY, FleetKeys
from orchestrator.clock.base import Clock, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.leadership.leadership import LEADER_TIMEOUT_NS, confirm_leader
from orchestrator.model.files.private_files import read_private_file, replace_private_file
from orchestrator.model.messages import HEARTBEAT_NS, LeaderHeartbeat

POLL_NS = HEARTBEAT_NS // 2


async def wait_for_vacancy(
    bus: Bus, keys: FleetKeys, clock: Clock, is_lease_over: Callable[[], bool] = lambda: True
) -> None:
    """Wait until no heartbeat has arrived for the time within which a live leader is received, measured while this
    process was awake: a process that slept, or was suspended, has received nothing. is_lease_over: whether no leader
    holds the lease either, at the same time."""
    heard_ns = clock.now_ns()
    leader: tuple[int, str] | None = None
    asking = TaskOwner()

    async def ask(heartbeat: LeaderHeartbeat) -> None:
        nonlocal leader, heard_ns
        if await confirm_leader(bus, keys, heartbeat):
            leader, heard_ns = (heartbeat.epoch, heartbeat.coordinator), clock.now_ns()

    def receive_heartbeat(sample: BusSample) -> None:
        nonlocal heard_ns
        try:
            heartbeat = LeaderHeartbeat.read_message(sample.payload)
        except ValidationError:
            return
        if (heartbeat.epoch, heartbeat.coordinator) == leader:
            heard_ns = clock.now_ns()
        elif not asking.pending:
            # Of a new leader, or forged: only one that answers keeps this process from leading.
            asking.spawn(ask(heartbeat))

    subscription = await bus.subscribe(keys.leader, receive_heartbeat)
    try:
        now_ns = clock.now_ns()
        while now_ns - heard_ns < LEADER_TIMEOUT_NS or not is_lease_over():
            await sleep_ns(clock, POLL_NS)
            overslept_ns, now_ns = clock.now_ns() - now_ns - POLL_NS, clock.now_ns()
            if overslept_ns > POLL_NS:
                heard_ns += overslept_ns
    finally:
        await subscription.undeclare()


async def stand_by(
    bus: Bus,
    keys: FleetKeys,
    clock: Clock,
    name: str,
    is_lease_over: Callable[[], bool] = lambda: True,
) -> None:
    """`wait_for_vacancy`; says meanwhile that a standby of this name waits."""
    token = await bus.announce(keys.live("coordinator", name, STANDBY))
    try:
        await wait_for_vacancy(bus, keys, clock, is_lease_over)
    finally:
        await token.undeclare()


class LeaderFile:
    """The file that names the process that leads on a journal."""

    def __init__(self, journal: Path) -> None:
        self._path = journal.with_name(journal.name + ".reign")

    def write_own_process(self) -> None:
        """Write this process into the file."""
        entry = {"pid": os.getpid(), "began": _process_start_time(os.getpid())}
        replace_private_file(self._path, json.dumps(entry).encode())

    def kill_other_process(self) -> int:
        """Kill the process that the file names, if it is still alive; return its process id, or 0."""
        try:
            fields = json.loads(read_private_file(self._path))
            pid, began = int(fields["pid"]), str(fields["began"])
        except (OSError, ValueError, KeyError, TypeError):
            return 0
        # The process id may have been reused since.
        if pid == os.getpid() or not began or _process_start_time(pid) != began:
            return 0
        try:
            os.kill(pid, signal.SIGKILL)
        except OSError:
            return 0
        return pid


def _process_start_time(pid: int) -> str:
    """The start time of a process of this boot, in clock ticks since boot (proc(5), stat, field 22); "" if there is
    none."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    # The second field, the name in parentheses, may contain any characters.
    return stat.rpartition(")")[2].split()[19]
