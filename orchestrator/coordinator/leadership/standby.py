"""Standing by: a second coordinator on the same journal, which reigns as soon as nobody else does.

A coordinator that is silent is dead or hangs. One that hangs may hold the journal in the middle of a transaction, and
would act on what it believed before when it wakes. Its epoch is over then and no adapter obeys it, but nobody could
write the journal; so the one that takes over ends it first. Who reigns stands in a file beside the journal.
"""

import json
import os
import signal
from pathlib import Path

from pydantic import ValidationError

from orchestrator.bus.base import Bus, Sample
from orchestrator.bus.keys import Keys
from orchestrator.clock.base import Clock, sleep_ns
from orchestrator.coordinator.leadership.leadership import HEARTBEAT_NS, LISTEN_NS
from orchestrator.model.messages import Reign

LOOK_NS = HEARTBEAT_NS // 2


async def vacancy(bus: Bus, keys: Keys, clock: Clock) -> None:
    """Wait until no reign has been heard for as long as a living coordinator is heard within, by a process that was
    awake: one that slept, or was stopped, has heard nobody."""
    heard_ns = clock.now_ns()

    def hear(sample: Sample) -> None:
        nonlocal heard_ns
        try:
            Reign.model_validate_json(sample.payload)
        except ValidationError:
            return
        heard_ns = clock.now_ns()

    subscription = await bus.subscribe(keys.reign, hear)
    try:
        now_ns = clock.now_ns()
        while now_ns - heard_ns < LISTEN_NS:
            await sleep_ns(clock, LOOK_NS)
            overslept_ns, now_ns = clock.now_ns() - now_ns - LOOK_NS, clock.now_ns()
            if overslept_ns > LOOK_NS:
                heard_ns += overslept_ns
    finally:
        await subscription.undeclare()


class Reigning:
    """The file that says which process reigns over a journal."""

    def __init__(self, journal: Path) -> None:
        self._path = journal.with_name(journal.name + ".reign")

    def write(self) -> None:
        """This process reigns."""
        fresh = self._path.with_name(self._path.name + ".new")
        fresh.write_text(json.dumps({"pid": os.getpid(), "began": _began(os.getpid())}), encoding="utf-8")
        fresh.replace(self._path)

    def end_other(self) -> int:
        """Kill the process that the file names, if it still lives; its process id, or 0."""
        try:
            said = json.loads(self._path.read_text(encoding="utf-8"))
            pid, began = int(said["pid"]), str(said["began"])
        except (OSError, ValueError, KeyError, TypeError):
            return 0
        # The same number may have been given to another process since.
        if pid == os.getpid() or not began or _began(pid) != began:
            return 0
        try:
            os.kill(pid, signal.SIGKILL)
        except OSError:
            return 0
        return pid


def _began(pid: int) -> str:
    """When a process of this boot began, in clock ticks since then (proc(5), stat, field 22); "" if there is none."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    # The second field, the name in parentheses, may hold anything.
    return stat.rpartition(")")[2].split()[19]
