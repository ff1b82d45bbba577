"""Jobs that others propose: they begin only with the plan that an operator has approved, and say what has changed."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.approval import JobPlan, list_changes
from orchestrator.model.queue import APPROVAL, WAITS_FOR_APPROVAL, QueueTerms
from orchestrator.model.report import QueueEntry
from orchestrator.runtime.virtual.fleet import VirtualFleet

PROPOSED = QueueTerms(proposed=True)
ABSOLUTE = job("[{do: move, to: {gantry.x: 20}}]")
RELATIVE = job("[{do: move, by: {gantry.x: 20}}]")
BY_NAME = job("[{do: move, to: sample}]")
BUSY = job("[{do: dwell, duration: 3 s}, {do: move, to: {gantry.y: 1}}]")


def fleet_with(**more: Any) -> Fleet:
    """The demo fleet with other entries of its file."""
    return Fleet.model_validate(demo_fleet().to_plain() | more)


FLEET = fleet_with(
    positions={"sample": {"gantry.x": "12 mm"}},
    permits={"door": {"input": "gantry.door", "value": False, "axes": ["gantry"]}},
    home_order=["gantry", "stage"],
)


async def refused(call: Awaitable[object]) -> Refusal:
    with pytest.raises(Refusal) as caught:
        await call
    return caught.value


async def entry(client: Tutti, job_id: str) -> QueueEntry:
    found = (await client.show_job(job_id)).entry
    assert found is not None
    return found


async def approve(client: Tutti, job_id: str) -> JobPlan:
    """Approve the plan of now, as an operator does."""
    plan = (await client.plan_job(job_id)).plan
    assert plan is not None
    await client.approve_job(job_id, plan)
    return plan


async def wait_until_held(client: Tutti, job_id: str) -> str:
    """Wait until a job is held again, with the reason."""
    async with asyncio.timeout(30):
        while (found := await entry(client, job_id)).held_by != APPROVAL:
            await asyncio.sleep(0.2)
    assert found.state == "queued"
    return found.reason


async def count_motions(fleet: VirtualFleet) -> int:
    return sum(len(unit.commanded_motions) for unit in fleet.controllers.values())


def test_a_re_run_of_a_job_that_was_never_approved_is_a_proposal_again() -> None:
    async def main(fleet: VirtualFleet) -> None:
        bob, anna = fleet.make_client("bob"), fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        motions = await count_motions(fleet)
        job_id = await bob.submit(ABSOLUTE, terms=PROPOSED)
        await anna.cancel_job(job_id)
        for terms in (None, QueueTerms(priority=3)):
            again = (await anna.retry_job(job_id, terms=terms)).job_id
            await asyncio.sleep(1.0)
            waiting = await entry(anna, again)
            assert (waiting.state, waiting.held_by, waiting.proposed) == ("queued", APPROVAL, True)
            assert waiting.terms.priority == (0 if terms is None else 3)
            # So it is with the re-run of a re-run.
            await anna.cancel_job(again)
            third = (await anna.retry_job(again)).job_id
            assert (await entry(anna, third)).held_by == APPROVAL
        assert (await refused(anna.retry_job(job_id, terms=QueueTerms(now=True)))).code == "bad-terms"
        assert await count_motions(fleet) == motions
        await approve(anna, third)
        assert (await anna.wait_for_job(third)).state == "done"
        # What was approved once is an operator's to run again.
        fourth = (await anna.retry_job(third)).job_id
        assert not (await entry(anna, fourth)).proposed
        assert (await anna.wait_for_job(fourth)).state == "done"

    run_fleet(main, FLEET)


def test_a_proposed_job_waits_for_its_approval_and_then_runs() -> None:
    async def main(fleet: VirtualFleet) -> None:
        bob, anna = fleet.make_client("bob"), fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        job_id = await bob.submit(BY_NAME, terms=PROPOSED)
        await asyncio.sleep(1.0)
        waiting = await entry(anna, job_id)
        assert (waiting.state, waiting.held_by, waiting.reason) == ("queued", APPROVAL, WAITS_FOR_APPROVAL)
        assert waiting.proposed and waiting.terms.proposed and waiting.place == 1
        # Others can be held and released meanwhile; all that is held, without this one.
        other = await bob.submit(ABSOLUTE, terms=QueueTerms(held=True))
        await anna.release_jobs()
        assert (await anna.wait_for_job(other)).state == "done"
        wrong = await refused(anna.release_jobs(job_id))
        assert wrong.code == "awaits-approval" and f"tutti job approve {job_id}" in wrong.remedy
        planned = await anna.plan_job(job_id)
        assert planned.changed == [] and planned.plan is not None
        parts = planned.plan.parts
        assert parts["position sample of gantry.x"] == "12 mm" and parts["offset of gantry.x"] == "0 mm"
        limits = [parts[f"{name} of gantry.x"] for name in ("velocity limit", "acceleration limit", "range")]
        assert limits == ["200 mm/s", "1000 mm/s²", "-10 mm to 400 mm"]
        assert parts["configuration of gantry"] == FLEET.controllers["gantry"].digest
        assert parts["permit door"] == "gantry.door not active, for gantry.x, gantry.y"
        assert not [name for name in parts if name.startswith("start of")]
        await anna.approve_job(job_id, planned.plan)
        report = await anna.wait_for_job(job_id)
        assert report.state == "done" and report.positions_used == {"sample": {"gantry.x": "12 mm"}}
        assert [(each.reason, each.actor) for each in report.transitions[:2]] == [
            (WAITS_FOR_APPROVAL, "bob"),
            (f"plan {planned.plan.hash} approved", "anna"),
        ]
        assert (await refused(anna.plan_job(job_id))).code == "ended"
        # A re-run by an operator is a job like any other.
        again = await anna.wait_for_job((await anna.retry_job(job_id)).job_id)
        assert again.state == "done"

    run_fleet(main, FLEET)


def test_what_does_not_fit_a_proposed_job_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        bob = fleet.make_client("bob")
        await outcome(fleet, PREPARE)
        for terms in (PROPOSED.model_copy(update={"now": True}), PROPOSED.model_copy(update={"session": "s"})):
            assert (await refused(bob.submit(ABSOLUTE, terms=terms))).code == "bad-terms"
        plain = await bob.submit(ABSOLUTE, terms=QueueTerms(held=True))
        plan = (await bob.plan_job(plain)).plan
        assert plan is not None
        wrong = await refused(bob.approve_job(plain, plan))
        assert wrong.code == "not-proposed" and "tutti job release" in wrong.remedy
        assert (await refused(bob.approve_job("none", plan))).code == "unknown-job"
        job_id = await bob.submit(ABSOLUTE, terms=PROPOSED)
        unseen = await refused(bob.approve_job(job_id, f"sha256:{'0' * 64}"))
        assert unseen.code == "plan-changed" and "has not shown" in unseen.text
        # Holding, moving and cancelling work as usual.
        await bob.hold_jobs(job_id)
        await bob.reorder_job(job_id, before=plain)
        assert (await entry(bob, job_id)).reason == WAITS_FOR_APPROVAL
        await bob.cancel_job(job_id)
        assert (await bob.wait_for_job(job_id)).state == "cancelled"
        assert (await refused(bob.approve_job(job_id, plan))).code == "ended"

    run_fleet(main)


def test_a_plan_that_changed_after_it_was_seen_is_not_approved() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        job_id = await anna.submit(BY_NAME, terms=PROPOSED)
        seen = (await anna.plan_job(job_id)).plan
        assert seen is not None
        await anna.save_position("sample", at={"gantry.x": "13 mm"})
        wrong = await refused(anna.approve_job(job_id, seen))
        assert wrong.code == "plan-changed" and f"tutti job plan {job_id}" in wrong.remedy
        assert "position sample of gantry.x was 12 mm, is 13 mm" in wrong.text
        assert (await entry(anna, job_id)).held_by == APPROVAL
        await approve(anna, job_id)
        assert (await anna.wait_for_job(job_id)).positions_used == {"sample": {"gantry.x": "13 mm"}}

    run_fleet(main, FLEET)


def test_a_hold_of_a_user_outlasts_the_approval() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna, ben = fleet.make_client("anna"), fleet.make_client("ben")
        await outcome(fleet, PREPARE)
        await anna.stop_queue()
        job_id = await anna.submit(ABSOLUTE, terms=PROPOSED)
        await approve(anna, job_id)
        await ben.hold_jobs(job_id)
        await approve(anna, job_id)
        assert (await entry(anna, job_id)).held_by == "ben"
        await ben.release_jobs(job_id)
        await anna.start_queue()
        assert (await anna.wait_for_job(job_id)).state == "done"

    run_fleet(main)


# What may change between the approval and the turn of a job


async def save_anew(fleet: VirtualFleet) -> None:
    await fleet.make_client().save_position("sample", at={"gantry.x": "13 mm"})


async def remove(fleet: VirtualFleet) -> None:
    await fleet.make_client().remove_position("other")


async def shift(fleet: VirtualFleet) -> None:
    await outcome(fleet, job("[{do: set-position, axes: {gantry.x: 5}}]"))


async def move_x(fleet: VirtualFleet) -> None:
    await outcome(fleet, job("[{do: move, to: {gantry.x: 7}}]"))


async def shift_and_move(fleet: VirtualFleet) -> None:
    """The axis stands elsewhere, at the same user position."""
    await outcome(fleet, job("[{do: move, to: {gantry.x: 7}}, {do: set-position, axes: {gantry.x: 0}}]"))


def reload(change: Callable[[dict[str, Any]], Any]) -> Callable[[VirtualFleet], Awaitable[None]]:
    async def act(fleet: VirtualFleet) -> None:
        plain = FLEET.to_plain()
        change(plain)
        await fleet.make_client().reload_fleet(Fleet.model_validate(plain))
        # A controller with another configuration has been off.
        await outcome(fleet, PREPARE)

    return act


def x_of(plain: dict[str, Any]) -> dict[str, Any]:
    return plain["controllers"]["gantry"]["axes"]["x"]


class Change(NamedTuple):
    """What changes, for a job with these steps, and the words for it."""

    steps: str
    act: Callable[[VirtualFleet], Awaitable[None]]
    words: str


TO_20 = "[{do: move, to: {gantry.x: 20}}]"
SWITCH = "[{do: output, output: gantry.lamp, value: true}]"
CHANGES = {
    "a position": Change("[{do: move, to: sample}]", save_anew, "position sample of gantry.x was 12 mm, is 13 mm"),
    "a position that is gone": Change("[{do: move, to: other}]", remove, "the fleet has no position other"),
    "an offset": Change(TO_20, shift, "offset of gantry.x was 0 mm, is 5 mm"),
    "an offset that hides a move": Change(
        "[{do: move, by: {gantry.x: 1}}]", shift_and_move, "offset of gantry.x was 0 mm, is -7 mm"
    ),
    "a start": Change("[{do: move, by: {gantry.x: 1}}]", move_x, "start of gantry.x was 0 mm, is 7 mm"),
    "a start in a repeat": Change(
        "[{do: repeat, times: 2, steps: [{do: move, by: {gantry.x: 1}}]}]", move_x, "start of gantry.x was 0 mm, is 7 mm"
    ),
    "the place of a set-position": Change(
        "[{do: set-position, axes: {gantry.x: 3}}, {do: move, to: {gantry.x: 9}}]",
        move_x,
        "start of gantry.x was 0 mm, is 7 mm",
    ),
    "a limit": Change(
        TO_20,
        reload(lambda plain: x_of(plain)["limits"].update(velocity=150)),
        "velocity limit of gantry.x was 200 mm/s, is 150 mm/s",
    ),
    "a soft limit": Change(
        TO_20,
        reload(lambda plain: x_of(plain)["soft_limits"].update(max=300)),
        "range of gantry.x was -10 mm to 400 mm, is -10 mm to 300 mm",
    ),
    "a soft limit that forbids it": Change(
        "[{do: move, to: {gantry.x: 250}}]", reload(lambda plain: x_of(plain)["soft_limits"].update(max=200)), "beyond its soft limits"
    ),
    "a configuration": Change(
        SWITCH,
        reload(lambda plain: plain["controllers"]["gantry"]["outputs"]["lamp"].update(number=2)),
        "configuration of gantry was",
    ),
    "the configuration of an input": Change(
        "[{do: wait, input: gantry.door, value: false, timeout: 1 s}]",
        reload(lambda plain: plain["controllers"]["gantry"]["inputs"]["door"].update(number=3)),
        "configuration of gantry was",
    ),
    "a permit": Change(
        TO_20,
        reload(lambda plain: plain["permits"]["door"].update(axes=None)),
        "permit door was gantry.door not active, for gantry.x, gantry.y, is gantry.door not active, for the whole fleet",
    ),
    "a permit that is gone": Change(TO_20, reload(lambda plain: plain["permits"].clear()), ", and is gone"),
    "a group": Change(
        "[{do: enable, axes: [table]}]",
        reload(lambda plain: plain["groups"].update(table=["gantry.x"])),
        "group table was gantry.x, gantry.y, stage.u, stage.v, is gantry.x",
    ),
    "the order of homing": Change(
        "[{do: home}]",
        reload(lambda plain: plain.update(home_order=["stage", "gantry"])),
        "order of homing was gantry.x, gantry.y; stage.u, stage.v, stage.focus, is stage.u",
    ),
    "a wire": Change(
        TO_20,
        reload(lambda plain: plain.update(wiring=[{"from": "gantry.lamp", "to": ["gantry.door"]}])),
        "wire from gantry.lamp is new: to gantry.door within 0 to 50 µs",
    ),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES.values(), ids=list(CHANGES))
def test_a_job_whose_plan_changed_after_its_approval_is_held_again_and_nothing_moves(change: Change) -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        await anna.save_position("other", at={"gantry.x": 3})
        job_id = await anna.submit(job(change.steps), terms=PROPOSED)
        await anna.stop_queue()
        before = await approve(anna, job_id)
        await anna.hold_jobs(job_id)
        await change.act(fleet)
        await anna.start_queue()
        moved = await count_motions(fleet)
        await anna.release_jobs(job_id)
        reason = await wait_until_held(anna, job_id)
        assert reason.startswith("held again: ") and change.words in reason, reason
        await asyncio.sleep(3.0)
        assert await count_motions(fleet) == moved
        assert (await anna.show_job(job_id)).transitions[-1].reason == reason
        assert not [held for held in (await anna.list_leases()) if held.holder == job_id]
        if "no position" in reason or "beyond" in reason:
            return
        # The operator sees what has changed, and approves that.
        planned = await anna.plan_job(job_id)
        assert planned.plan is not None and planned.changed == list_changes(before, planned.plan)
        assert planned.changed and planned.changed[0] in reason
        await anna.approve_job(job_id, planned.plan)
        assert (await anna.wait_for_job(job_id)).state == "done"

    run_fleet(main, FLEET)


def test_where_axes_are_does_not_matter_for_absolute_steps() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        steps = "[{do: move, to: {gantry.x: 20}}, {do: move, by: {gantry.x: 1}}, {do: scan, axes: {gantry.y: {values: [1, 2]}}}]"
        first = await anna.submit(job(steps), terms=PROPOSED.model_copy(update={"held": True, "repeat": 2}))
        await approve(anna, first)
        assert (await anna.wait_for_job(first)).state == "done"
        again = await anna.retry_job(first, 3, terms=PROPOSED)
        plan = await approve(anna, again.job_id)
        assert plan.parts["first step"] == "4" and "start of gantry.x" not in plan.parts
        assert (await anna.wait_for_job(again.job_id)).state == "done"

    run_fleet(main)


def test_a_job_that_moves_by_a_distance_cannot_be_planned_while_its_axis_moves() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        job_id = await anna.submit(RELATIVE, terms=PROPOSED)
        running = await anna.submit(job("[{do: move, to: {gantry.x: 300}, speed: 0.3}]"))
        await fleet.wait_until(lambda states: states["gantry"].axes["x"].moving)
        assert (await refused(anna.plan_job(job_id))).code == "moving"
        await anna.wait_for_job(running)
        await approve(anna, job_id)
        assert (await anna.wait_for_job(job_id)).state == "done"
        fleet.wires["stage"].cut = True
        await fleet.wait_until(lambda states: states["stage"].mode == "offline")
        unknown = await anna.submit(job("[{do: move, to: {stage.u: 1}}]"), terms=PROPOSED)
        assert (await refused(anna.plan_job(unknown))).code == "offline"

    run_fleet(main)


# Restarts, and the journal


async def restart(fleet: VirtualFleet, epoch: int) -> None:
    """Another coordinator leads."""
    for name, (process, _) in fleet.coordinators.items():
        if process.alive:
            fleet.kill(f"coordinator/{name}")
    await sleep_ns(fleet.clock, NS_PER_S)
    fleet.start_coordinator(f"leader{epoch}")
    await fleet.wait_until(lambda states: all(state.epoch == epoch for state in states.values()))


@pytest.mark.parametrize("changes", [False, True])
def test_an_approval_outlives_the_coordinator_and_is_checked_by_the_next_one(changes: bool) -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        approved, waiting = [await anna.submit(BY_NAME, terms=PROPOSED) for _ in range(2)]
        await anna.stop_queue()
        await approve(anna, approved)
        await restart(fleet, 2)
        assert [(await entry(anna, each)).held_by for each in (approved, waiting)] == ["", APPROVAL]
        assert (await anna.plan_job(approved)).changed == []
        if changes:
            await save_anew(fleet)
        await anna.start_queue()
        if changes:
            reason = await wait_until_held(anna, approved)
            assert reason == "held again: position sample of gantry.x was 12 mm, is 13 mm"
            # The reason outlives the next one, also over other changes of the job.
            await anna.reorder_job(waiting, before=approved)
            await anna.reorder_job(approved, before=waiting)
            await restart(fleet, 3)
            await asyncio.sleep(1.0)
            assert (await entry(anna, approved)).reason == reason
            await approve(anna, approved)
        assert (await anna.wait_for_job(approved)).state == "done"
        assert (await entry(anna, waiting)).reason == WAITS_FOR_APPROVAL

    run_fleet(main, FLEET)


def damage_body(fleet: VirtualFleet) -> None:
    fleet.journal.database.write("UPDATE approvals SET body = replace(body, '12 mm', '13 mm')")


def delete_approval(fleet: VirtualFleet) -> None:
    fleet.journal.database.write("DELETE FROM approvals")


def release_by_damage(fleet: VirtualFleet) -> None:
    delete_approval(fleet)
    fleet.journal.database.write("UPDATE jobs SET held_by = ''")


@pytest.mark.parametrize("damage", [damage_body, delete_approval, release_by_damage])
def test_a_damaged_journal_begins_no_job_without_an_approval(damage: Callable[[VirtualFleet], None]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        job_id = await anna.submit(BY_NAME, terms=PROPOSED)
        await anna.stop_queue()
        await approve(anna, job_id)
        moved = await count_motions(fleet)
        damage(fleet)
        await restart(fleet, 2)
        await anna.start_queue()
        assert (await wait_until_held(anna, job_id)).startswith("held again: ")
        assert await count_motions(fleet) == moved
        await approve(anna, job_id)
        assert (await anna.wait_for_job(job_id)).state == "done"

    run_fleet(main, FLEET)


def test_an_approval_that_was_void_once_does_not_count_again_although_the_plan_is_what_it_was() -> None:
    """A damaged journal releases the job."""

    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        job_id = await anna.submit(BY_NAME, terms=PROPOSED)
        await anna.stop_queue()
        await approve(anna, job_id)
        await save_anew(fleet)
        moved = await count_motions(fleet)
        await anna.start_queue()
        assert "is 13 mm" in await wait_until_held(anna, job_id)
        await anna.stop_queue()
        await fleet.make_client().save_position("sample", at={"gantry.x": "12 mm"})
        assert not (await anna.plan_job(job_id)).changed
        fleet.journal.database.write("UPDATE jobs SET held_by = ''")
        await restart(fleet, 2)
        await anna.start_queue()
        assert "no plan of it is approved" in await wait_until_held(anna, job_id)
        assert await count_motions(fleet) == moved

    run_fleet(main, FLEET)


def test_a_job_that_no_longer_states_that_it_was_proposed_is_damaged() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        job_id = await anna.submit(job("[{do: dwell, duration: 1 s}]"), terms=PROPOSED)
        fleet.journal.database.write("UPDATE jobs SET proposed = 0, held_by = ''")
        await restart(fleet, 2)
        report = await anna.wait_for_job(job_id)
        assert report.state == "failed" and "its checksum is wrong" in report.reason

    run_fleet(main)


def test_a_full_disk_approves_nothing_and_holds_all_the_same() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        job_id = await anna.submit(BY_NAME, terms=PROPOSED)
        fleet.coordinator_disk.full = True
        assert (await refused(approve(anna, job_id))).code == "journal"
        assert (await entry(anna, job_id)).held_by == APPROVAL
        fleet.coordinator_disk.full = False
        await anna.stop_queue()
        await approve(anna, job_id)
        await save_anew(fleet)
        moved = await count_motions(fleet)
        await anna.start_queue()
        fleet.coordinator_disk.full = True
        assert "is 13 mm" in await wait_until_held(anna, job_id)
        await asyncio.sleep(10.0)
        fleet.coordinator_disk.full = False
        # What was not recorded is found again.
        await restart(fleet, 2)
        await anna.start_queue()
        assert "is 13 mm" in await wait_until_held(anna, job_id)
        assert await count_motions(fleet) == moved

    run_fleet(main, FLEET)


def test_a_plan_of_many_steps_lets_other_work_have_its_turn() -> None:
    async def main(fleet: VirtualFleet) -> None:
        anna = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        steps = ", ".join(f"{{do: move, to: {{gantry.x: {number % 10}}}}}" for number in range(1, 501))
        job_id = await anna.submit(job(f"[{steps}]"), terms=PROPOSED)
        planned, state = await asyncio.gather(anna.plan_job(job_id), anna.status())
        assert planned.plan is not None and len(planned.plan.parts) < 10 and len(state) == 2
        other = await anna.submit(job(f"[{steps.replace('gantry.x: 9}', 'gantry.x: 8}', 1)}]"), terms=PROPOSED)
        changed = (await anna.plan_job(other)).plan
        assert changed is not None
        assert [each.partition(" was ")[0] for each in list_changes(planned.plan, changed)] == ["job"]

    run_fleet(main)
