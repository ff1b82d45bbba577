"""Proposers, operators, and everything that changes meanwhile, at random: no proposed job begins but as it was approved.

What a job depends on is read from the simulated controllers and the fleet, not from its plan.
"""

# pyright: reportPrivateUsage=false

import asyncio
from contextlib import suppress
from random import Random
from typing import Any, NamedTuple

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.bus.base import BusSample
from orchestrator.coordinator.jobs import job_plan
from orchestrator.coordinator.jobs.intake.approval import JobApprovals
from orchestrator.coordinator.jobs.run.preparation import JobPreparation
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import Reply
from orchestrator.model.operation.recording import JobBegun
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import FINISHED_STATES
from orchestrator.model.state import ControllerState
from orchestrator.runtime.virtual.fleet import VirtualFleet

Patch = pytest.MonkeyPatch
PROPOSED = QueueTerms(proposed=True)
KINDS = {
    "absolute": "[{do: move, to: {gantry.x: 20}, speed: 0.5}]",
    "by name": "[{do: move, to: spot, speed: 0.5}, {do: move, by: {gantry.x: 1}}]",
    "relative": "[{do: move, by: {gantry.x: 2}, speed: 0.5}]",
}


class Snapshot(NamedTuple):
    """What a job of a kind depends on: what it does not depend on is None."""

    spot: str | None
    offset: str | None
    place: int | None
    velocity: float


class Approval(NamedTuple):
    """A plan that an operator has seen, and what it depended on then."""

    plan: str
    seen: Snapshot


class Scene:
    """Users of one fleet. violations: proposed jobs that began otherwise than approved."""

    def __init__(self, fleet: VirtualFleet, seed: int) -> None:
        self.fleet = fleet
        self.draw = Random(seed)
        self.client = fleet.make_client("anna")
        self.spot = "12 mm"
        self.offset = ""
        self.kinds: dict[str, str] = {}
        self.seen: dict[str, Approval] = {}
        self.approved: dict[str, list[Snapshot]] = {}
        self.begun: list[str] = []
        self.violations: list[str] = []

    async def start(self) -> None:
        client = self.client
        await client.bus.subscribe(client.keys.state("gantry"), self._take_state)
        await client.bus.subscribe(client.keys.job_begun(), self._take_beginning)
        assert (await outcome(self.fleet, PREPARE)).state == "done"
        await client.save_position("spot", at={"gantry.x": self.spot})

    def _take_state(self, sample: BusSample) -> None:
        self.offset = str(ControllerState.model_validate_json(sample.payload).axes["x"].offset)

    def look(self, kind: str, spot: str) -> Snapshot:
        relative = kind == "relative"
        return Snapshot(
            spot if kind == "by name" else None,
            None if relative else self.offset,
            round(self.fleet.controllers["gantry"].position("X")) if relative else None,
            self.fleet.fleet.controllers["gantry"].axes["x"].limits.velocity,
        )

    def _take_beginning(self, sample: BusSample) -> None:
        begun = JobBegun.model_validate_json(sample.payload)
        kind = self.kinds.get(begun.job_id)
        if kind is None:
            return
        self.begun.append(begun.job_id)
        now = self.look(kind, begun.positions_used.get("spot", {}).get("gantry.x", ""))
        approved = self.approved.get(begun.job_id, [])
        if now not in approved:
            self.violations.append(f"{kind} began with {now}, approved: {approved}")

    # What users do

    async def propose(self) -> None:
        kind = self.draw.choice(list(KINDS))
        self.kinds[await self.client.submit(job(KINDS[kind]), terms=PROPOSED)] = kind

    async def see(self, job_id: str) -> None:
        before = self.look(self.kinds[job_id], self.spot)
        plan = (await self.client.plan_job(job_id)).plan
        if plan is not None and before == self.look(self.kinds[job_id], self.spot):
            self.seen[job_id] = Approval(plan.hash, before)

    async def approve(self, job_id: str) -> None:
        """One that was seen some time ago."""
        approval = self.seen.get(job_id)
        if approval is not None:
            # It may begin before the answer is here.
            self.approved.setdefault(job_id, []).append(approval.seen)
            try:
                await self.client.approve_job(job_id, approval.plan)
            except Refusal:
                self.approved[job_id].remove(approval.seen)
                raise

    async def run(self, by_hand: Job) -> None:
        """Run a job before all others."""
        await self.client.start_queue()
        await self.client.wait_for_job(await self.client.submit(by_hand, terms=QueueTerms(priority=9)))

    async def change(self) -> None:
        """Something that jobs depend on."""
        match self.draw.randrange(5):
            case 0 | 1:
                self.spot = f"{self.draw.randrange(10, 14)} mm"
                await self.client.save_position("spot", at={"gantry.x": self.spot})
            case 2:
                value = self.draw.randrange(3)
                await self.run(job(f"[{{do: set-position, axes: {{gantry.x: {value}}}}}]"))
            case 3:
                await self.run(job(f"[{{do: move, to: {{gantry.x: {self.draw.randrange(4)}}}}}]"))
            case _:
                plain = self.fleet.fleet.to_plain()
                plain["controllers"]["gantry"]["axes"]["x"]["limits"]["velocity"] = self.draw.choice((150, 200))
                await self.client.reload_fleet(Fleet.model_validate(plain))
                await self.run(PREPARE)

    async def act(self) -> None:
        some = self.draw.choice(list(self.kinds)) if self.kinds else ""
        drawn = self.draw.random()
        with suppress(Refusal):
            if not some or drawn < 0.2:
                await self.propose()
            elif drawn < 0.4:
                await self.see(some)
            elif drawn < 0.6:
                await self.approve(some)
            elif drawn < 0.85:
                await self.change()
            elif drawn < 0.88:
                await self.client.hold_jobs(some)
            elif drawn < 0.91:
                await self.client.stop_queue()
            elif drawn < 0.97:
                await self.client.release_jobs()
                await self.client.start_queue()
            else:
                await restart(self.fleet)
        await asyncio.sleep(self.draw.choice((0.0, 0.2, 2.0)))

    async def finish(self) -> list[str]:
        """Approve and run what is left; the states in which the jobs end."""
        async with asyncio.timeout(600):
            while True:
                await self.client.start_queue()
                await self.client.release_jobs()
                listed = [each for each in (await self.client.list_jobs(1000)).jobs if each.id in self.kinds]
                left = [each.id for each in listed if each.state not in FINISHED_STATES]
                if not left:
                    return [each.state for each in listed]
                for job_id in left:
                    with suppress(Refusal):
                        await self.see(job_id)
                        await self.approve(job_id)
                await asyncio.sleep(1.0)


async def restart(fleet: VirtualFleet) -> None:
    fleet.kill("coordinator/first")
    await asyncio.sleep(1.5)
    fleet.start_coordinator("first")
    await fleet.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))
    await asyncio.sleep(2.0)


def run_seed(seed: int) -> Scene:
    async def main(fleet: VirtualFleet) -> Scene:
        scene = Scene(fleet, seed)
        await scene.start()
        for _ in range(60):
            await scene.act()
        states = await scene.finish()
        assert set(states) <= {"done", "interrupted"}, states
        return scene

    return run_fleet(main, demo_fleet(), seed=seed)


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(n, marks=pytest.mark.nightly) for n in range(2, 60))])
def test_no_proposed_job_begins_but_as_it_was_approved(seed: int) -> None:
    scene = run_seed(seed)
    assert scene.violations == [] and len(scene.begun) > 5


def compares_no_plan(patch: Patch) -> None:
    """The turn of a job is not a moment at which its plan is made again."""

    async def find_nothing(*_: object) -> str:
        return ""

    patch.setattr(JobPreparation, "_find_deviation", find_nothing)


def leaves_places_out(patch: Patch) -> None:
    """A plan states neither offsets nor places."""
    patch.setattr(job_plan, "_describe_places", lambda *_: {})


def leaves_limits_out(patch: Patch) -> None:
    """A plan states neither limits nor configurations."""
    honest = job_plan.make_plan

    async def make_less(*values: Any) -> Any:
        plan = await honest(*values)
        kept = {name: text for name, text in plan.parts.items() if "limit" not in name and "configuration" not in name}
        return plan.of(kept)

    for module in ("run.preparation", "intake.approval"):
        patch.setattr(f"orchestrator.coordinator.jobs.{module}.make_plan", make_less)


def approves_anything(patch: Patch) -> None:
    """The plan of now is approved, whatever plan the operator has seen."""
    honest = JobApprovals.approve_job

    async def approve_now(self: JobApprovals, request: Any) -> Reply:
        plan = (await self.plan_job(request)).plan
        return await honest(self, request.model_copy(update={"plan": plan.hash if plan else ""}))

    patch.setattr(JobApprovals, "approve_job", approve_now)


@pytest.mark.parametrize("breaks", [compares_no_plan, leaves_places_out, leaves_limits_out, approves_anything])
def test_the_seeds_find_the_violation(breaks: Any, monkeypatch: Patch) -> None:
    breaks(monkeypatch)
    assert any(run_seed(seed).violations for seed in (4, 1, 3, 7))
