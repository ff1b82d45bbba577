"""A fleet whose journal is in databases on three machines: the life of some jobs, with a fault at a commit of it."""

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from contextvars import Context
from dataclasses import dataclass, field
from typing import Any, TypeVar

from cluster.worlds import PREPARE, demo_fleet, job, outcome

from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.leadership.lease import LeaderLease
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import JournalPolicy
from orchestrator.model.report import FINISHED_STATES
from orchestrator.runtime.virtual.databases.site import CommitMoment, DatabaseSite
from orchestrator.runtime.virtual.fleet import VirtualFleet

T = TypeVar("T")
MACHINES = ("db-a", "db-b", "db-c")
TWO_COPIES = JournalPolicy(copies=2)
LEASE_NS = JournalPolicy().lease
MORE_NS = 2 * NS_PER_S  # than lease and promotion, until the next leader leads
WITHDRAWAL = "withdraw_decision"
LEASE_CALLS = {LeaderLease.renew.__name__, LeaderLease.release.__name__, LeaderLease.read_turn.__name__}
# Each moves an axis of its own, once a step.
LONG = job("[{do: move, by: {gantry.x: 30 mm}, speed: 0.2}, {do: move, by: {gantry.y: 5 mm}}]")
SHORT = job("[{do: move, by: {stage.u: 2}}]")
HELD = job("[{do: move, by: {stage.focus: 200}}]")
STARTS_NS = 300 * NS_PER_MS  # a motion begins this near to what its journal says


def run_site(
    main: Callable[[VirtualFleet, DatabaseSite], Coroutine[Any, Any, T]],
    machines: tuple[str, ...] = MACHINES,
    seed: int = 1,
    policy: JournalPolicy = TWO_COPIES,
) -> T:
    """Run `main` with a prepared fleet, a leader `first` and a standby `second`. policy: of the fleet file."""

    async def run(clock: VirtualClock) -> T:
        site = DatabaseSite(machines)
        fleet = demo_fleet().model_copy(update={"journal": policy})
        virtual = VirtualFleet(fleet, clock, seed)
        virtual.use_databases(site)
        await virtual.start()
        virtual.start_coordinator("second", standby=True)
        assert (await outcome(virtual, PREPARE)).state == "done"
        return await main(virtual, site)

    return run_virtual(run)


@dataclass
class Life:
    """The life of some jobs. accepted: ids by the names of jobs. facts: what each commit of the leader stored."""

    fleet: VirtualFleet
    site: DatabaseSite
    accepted: dict[str, str] = field(default_factory=dict[str, str])
    facts: list[tuple[str, ...]] = field(default_factory=list[tuple[str, ...]])

    def strike_at(self, commit: int | str, moment: CommitMoment, strike: Callable[[], None]) -> None:
        """Call `strike` at a commit of the first leader's journal: by its number, counted from 0, or the first one that
        stores a fact. `WITHDRAWAL`: a start that is late is arranged, whose decision is withdrawn."""
        is_struck = is_delayed = False

        def look(at: CommitMoment, computer: str) -> None:
            nonlocal is_struck, is_delayed
            if computer != "first" or LEASE_CALLS & set(self.site.facts):
                return
            if at == "before":
                self.facts.append(self.site.facts)
            is_reached = commit in self.facts[-1] if isinstance(commit, str) else len(self.facts) == commit + 1
            if at == moment and is_reached and not is_struck:
                is_struck = True
                strike()
            if commit == WITHDRAWAL and at == "after" and "record_decision" in self.facts[-1] and not is_delayed:
                is_delayed = True
                Context().run(self.fleet.clock.loop.create_task, self._suspend_host())

        self.site.on_commit = look

    async def _suspend_host(self) -> None:
        """Suspend the adapter host so that the request to start comes too late, and is refused in time."""
        await sleep_ns(self.fleet.clock, 3 * NS_PER_MS)
        self.fleet.freeze("host/local")
        await sleep_ns(self.fleet.clock, 300 * NS_PER_MS)
        self.fleet.resume("host/local")

    async def live(self) -> None:
        """Submit jobs, change the queue, and let all of it end, whoever leads."""
        client = self.fleet.make_client()
        await self._repeat(client.stop_queue)
        for name, work in (("long", LONG), ("short", SHORT), ("held", HELD)):
            await self._submit(client, name, work)
        await self._repeat(lambda: client.hold_jobs(self.accepted["held"]))
        await self._repeat(lambda: client.reorder_job(self.accepted["short"], self.accepted["long"]))
        await self._repeat(lambda: client.release_jobs(self.accepted["held"]))
        for _ in range(120):
            if self._are_ended():
                return
            with suppress(Refusal):
                await client.release_jobs()  # a job that has failed holds those behind it
                await client.start_queue()
            await sleep_ns(self.fleet.clock, NS_PER_S)
        rows = [self.fleet.journal.load_record(job_id) for job_id in self.accepted.values()]
        raise AssertionError([row and (row.state, row.reason) for row in rows])

    def _are_ended(self) -> bool:
        rows = [self.fleet.journal.load_record(job_id) for job_id in self.accepted.values()]
        return all(row is None or row.state in FINISHED_STATES for row in rows)

    async def _submit(self, client: Tutti, name: str, work: Job) -> None:
        key = self.fleet.draw_id()

        async def submit() -> None:
            self.accepted[name] = (await client.submit(work, key)).id

        await self._repeat(submit)

    async def _repeat(self, act: Callable[[], Coroutine[Any, Any, Any]]) -> None:
        """Ask again until there is an answer: what a job does not allow any more is one."""
        for _ in range(60):
            try:
                async with asyncio.timeout(5):
                    await act()
            except Refusal as refusal:
                if refusal.code in {"job-ended", "wrong-state", "not-queued"}:
                    return
            except TimeoutError:
                pass
            else:
                return
            await sleep_ns(self.fleet.clock, NS_PER_S)
        raise AssertionError("no coordinator answers")

    def check(self, motions_before: dict[str, int]) -> None:
        """Nothing that was accepted is lost, nothing has run twice, and nothing has moved unasked."""
        journal, moved = self.fleet.journal, dict[str, list[int]]()
        origin_ns = next(
            each.leadership.scale.origin_host_ns
            for _, each in self.fleet.coordinators.values()
            if each.leadership.epoch
        )
        for name, unit in self.fleet.controllers.items():
            for motion in unit.commanded_motions[motions_before[name] :]:
                moved.setdefault(f"{name}.{motion.axis}", []).append(motion.start_ns - origin_ns)
        assert all(len(starts) == 1 for starts in moved.values()), moved
        for name, motors in (("long", ("gantry.X", "gantry.Y")), ("short", ("stage.1",)), ("held", ("stage.3",))):
            job_id = self.accepted[name]
            row = journal.load_record(job_id)
            assert row is not None, f"{name} is lost"
            changes = journal.list_transitions(job_id)
            ends = [change for change in changes if change.state in FINISHED_STATES]
            assert "defect" not in row.reason, row.reason
            assert len(ends) == 1, (name, changes)
            starts = [start for motor in motors for start in moved.get(motor, [])]
            for start_ns in starts:
                assert (changes[0].fleet_ns or 0) <= start_ns <= (ends[0].fleet_ns or 0) + STARTS_NS, (name, changes)
            assert row.state != "done" or len(starts) == len(motors)


def count_motions(fleet: VirtualFleet) -> dict[str, int]:
    return {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()}


def promote_later(fleet: VirtualFleet, site: DatabaseSite, after_ns: int) -> None:
    """Promote a standby, as what watches the databases of a site does."""

    def promote() -> None:
        successor = site.find_successor()
        assert successor is not None
        site.promote(successor)

    fleet.clock.call_at_ns(fleet.clock.now_ns() + after_ns, promote, context=Context())


async def wait_for_leader(fleet: VirtualFleet, name: str) -> int:
    """Wait until a coordinator has adopted all controllers; the instant, host ns."""
    await fleet.wait_until(
        lambda states: all(each.epoch == fleet.coordinators[name][1].leadership.epoch > 0 for each in states.values())
    )
    return fleet.clock.now_ns()


def strike_life(
    commit: int | str, moment: CommitMoment, strike: Callable[[VirtualFleet, DatabaseSite], None], commit_ns: int = 0
) -> "Struck":
    """Live a life with a fault at one commit of it, as of `Life.strike_at`, and check it. strike: the fault. commit_ns:
    how much longer each commit takes than usual."""

    async def main(fleet: VirtualFleet, site: DatabaseSite) -> Struck:
        site.commit_ns = commit_ns
        life, before, struck = Life(fleet, site), count_motions(fleet), Struck()

        def strike_once() -> None:
            struck.at_ns = fleet.clock.now_ns()
            strike(fleet, site)
            if not fleet.coordinators["first"][0].alive:
                Context().run(fleet.clock.loop.create_task, note_leader())

        async def note_leader() -> None:
            struck.led_ns = await wait_for_leader(fleet, "second") - struck.at_ns

        life.strike_at(commit, moment, strike_once)
        await life.live()
        life.check(before)
        struck.facts, struck.lines = life.facts, fleet.lines
        return struck

    return run_site(main)


@dataclass
class Struck:
    """at_ns: of the fault, host ns; 0: there was none. led_ns: from then until the standby had adopted all."""

    at_ns: int = 0
    led_ns: int = 0
    facts: list[tuple[str, ...]] = field(default_factory=list[tuple[str, ...]])
    lines: list[str] = field(default_factory=list[str])
