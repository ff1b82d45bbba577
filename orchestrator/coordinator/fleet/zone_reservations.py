"""Where jobs may move axes of keep-out zones: what a running step sweeps is reserved, so that a step of another job
waits for it instead of meeting it."""

import asyncio
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass

from orchestrator.plan.zones.chain import Box

ZONE_BUSY = "zone-busy"
"""Code of a step that a zone refuses while a running job has axes of the same rule: it may go on by and by."""
WAIT_S = 60.0
"""For how long a step waits at most."""
LOOK_S = 1.0
"""Between two looks while nothing is reported: an axis that was stopped has come to rest."""
WHOLE_STEP = -1
"""The index of a reservation that no motion step has: of a search for references, or a probe."""


@dataclass(frozen=True, slots=True)
class _Reservation:
    index: int
    box: Box


def _find_no_owner(axis: str) -> None:
    del axis


class ZoneReservations:
    """The boxes that steps of running jobs may sweep, by the holder of their leases.

    Between its steps a job has none: its axes stand where they are, and its next step is checked against what others
    have reserved by then. Checks and reservations take turns (`lock`), so that no two steps are checked without each
    other.
    """

    def __init__(self) -> None:
        self.lock = asyncio.Lock()
        self.find_owner: Callable[[str], str | None] = _find_no_owner
        """The holder of the lease of an axis. It counts before the adapter has it."""
        self._jobs: dict[str, list[_Reservation]] = {}
        self._blockers: dict[str, frozenset[str]] = {}
        self._waits: dict[str, frozenset[str]] = {}
        self._changed = asyncio.Event()

    def enter(self, holder: str) -> None:
        """A job runs: all its motions are checked and reserved from now on."""
        self._jobs.setdefault(holder, [])

    def leave(self, holder: str) -> None:
        """It has ended."""
        self._jobs.pop(holder, None)
        self._waits.pop(holder, None)
        self._blockers.pop(holder, None)
        self._note_change()

    def is_job(self, holder: str) -> bool:
        """Whether a holder of leases is a running job."""
        return holder in self._jobs

    def list_jobs(self) -> frozenset[str]:
        """The holders of leases that are running jobs now."""
        return frozenset(self._jobs)

    def reserve(self, holder: str, index: int, box: Box, *, behind: bool = False) -> None:
        """Reserve where a step may move axes; in place of what its job has reserved before, unless it begins behind a
        step that moves now."""
        if holder not in self._jobs:
            return
        if not behind:
            self._jobs[holder].clear()
        self._jobs[holder].append(_Reservation(index, box))

    def end(self, holder: str, index: int) -> None:
        """A step of a job is over."""
        reservations = self._jobs.get(holder)
        if reservations:
            reservations[:] = [entry for entry in reservations if entry.index not in (index, WHOLE_STEP)]
            self._note_change()

    def find_box(self, axis: str, holder: str) -> tuple[float, float] | None:
        """Between which positions steps of others may move an axis now; None: none of them moves it."""
        ends = [
            entry.box[axis]
            for other_holder, entries in self._jobs.items()
            if other_holder != holder
            for entry in entries
            if axis in entry.box
        ]
        return (min(low for low, _ in ends), max(high for _, high in ends)) if ends else None

    # Waiting

    def note_blockers(self, holder: str, blockers: Collection[str]) -> None:
        """A step of a job is refused as long as these other jobs have their axes."""
        self._blockers[holder] = frozenset(blockers)

    def begin_wait(self, holder: str) -> str | None:
        """A job waits for what blocks it; or the holder of a job that waits for it already, and then it does not."""
        blockers = self._blockers.get(holder, frozenset())
        circle = next((blocker for blocker in sorted(blockers) if self._waits_for(blocker, holder)), None)
        if circle is None:
            self._waits[holder] = blockers
        return circle

    def end_wait(self, holder: str) -> None:
        """It waits no longer."""
        self._waits.pop(holder, None)

    async def wait_for_change(self) -> None:
        """Wait until a step or a job has ended, or for `LOOK_S`."""
        change = self._changed
        with suppress(TimeoutError):
            async with asyncio.timeout(LOOK_S):
                await change.wait()

    def _waits_for(self, waiter: str, holder: str) -> bool:
        """Whether a job waits for another one, also by way of others."""
        reached_jobs, todo = {waiter}, [waiter]
        while todo:
            for blocker in self._waits.get(todo.pop(), frozenset()):
                if blocker == holder:
                    return True
                if blocker not in reached_jobs:
                    reached_jobs.add(blocker)
                    todo.append(blocker)
        return False

    def _note_change(self) -> None:
        """All that wait look again: until then it is not known what they wait for."""
        self._waits.clear()
        self._changed.set()
        self._changed = asyncio.Event()
