"""What another client changes at a controller makes a job wait, before it begins or at its step; it fails no job."""

import asyncio
from dataclasses import dataclass

import pytest
from cluster.worlds import begin_ready, job, line_fleet, outcome, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import FINISHED_STATES
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.cia402.unit import SimulatedDrive


@dataclass(frozen=True)
class Change:
    """command: of another client, which changes the first axis; None: an object of a drive's dictionary. lost: the
    reference is lost by it."""

    axis: str
    command: str | None
    lost: bool


CHANGES = {
    "smc4000": Change("gantry.x", "ITX=0.02", lost=False),
    "smc2000": Change("feeder.x", "ITX=0.02", lost=False),
    "shrc203": Change("stage.u", "S:1,10", lost=True),
    "ppsmc": Change("table.turn", "gnum1:2000", lost=True),
    "cia402": Change("arm.r", None, lost=True),
}


async def _change_setting(fleet: VirtualFleet, change: Change) -> None:
    controller = change.axis.partition(".")[0]
    if change.command is not None:
        await fleet.make_client("ben").send_raw(controller, change.command, i_know=True)
        return
    unit = fleet.controllers[controller]
    assert isinstance(unit, SimulatedDrive)
    unit.station.dictionary.put_value(0x607C, 0, 500)


def _prepare(controller: str) -> Job:
    return job(f"[{{do: enable, axes: [{controller}]}}, {{do: home, axes: [{controller}]}}]")


async def _home(client: Tutti, axis: str) -> None:
    """As `tutti axis home` does, which no waiting job keeps from the axis."""
    async with client.attend() as attendance:
        terms = QueueTerms(session=attendance.session, now=True)
        job_id = await client.submit(job(f"[{{do: home, axes: [{axis}]}}]"), terms=terms)
        assert (await client.wait_for_job(job_id)).state == "done"


@pytest.mark.parametrize("make", CHANGES)
def test_a_job_waits_for_a_setting_that_was_changed_since_the_last_one(make: str) -> None:
    """It begins after the end of the cause and a word, and nothing has moved before."""
    change = CHANGES[make]
    controller, _, axis = change.axis.partition(".")
    move = job(f"[{{do: move, by: {{{change.axis}: 2}}}}]")

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        assert (await outcome(fleet, _prepare(controller))).state == "done"
        motions = len(fleet.controllers[controller].commanded_motions)
        await _change_setting(fleet, change)
        job_id = await client.submit(move)
        await fleet.wait_until(lambda states: states[controller].mode == "fault")
        await asyncio.sleep(1.0)
        entry = (await client.show_job(job_id)).entry
        assert entry.state == "queued" and "another client has changed it; `tutti reset`" in entry.reason
        assert len(fleet.controllers[controller].commanded_motions) == motions
        assert not any((await client.reset()).values())
        assert (await client.status())[controller].axes[axis].referenced is not change.lost
        if change.lost:
            await _home(client, change.axis)
        await begin_ready(client, job_id)
        assert (await client.wait_for_job(job_id)).state == "done"

    run_fleet(main, line_fleet(controller))


@pytest.mark.parametrize("rest_s", [0, 15])
def test_a_job_waits_at_its_step_for_a_setting_that_was_changed_after_it_began(rest_s: float) -> None:
    """It goes on by a word, from where the steps before have moved to; without the repair the step is refused again.

    rest_s: the change is found while the step is armed, or at rest before."""
    steps = job("[{do: move, by: {gantry.x: 2}, speed: 2 mm/s}, {do: move, by: {gantry.x: 3}}]")

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        assert (await outcome(fleet, _prepare("gantry"))).state == "done"
        gantry = fleet.controllers["gantry"]
        begin_counts = gantry.position("X")
        job_id = await client.submit(steps)
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        await client.pause_job(job_id)
        assert await _wait_for_pause(client, job_id) == "paused by anna after step 1"
        await _change_beside(fleet, CHANGES["smc4000"])
        await asyncio.sleep(rest_s)
        for _ in range(2):
            reason = await _resume_in_vain(client, job_id)
            assert reason.startswith("waits after step 1 for: ")
            assert "another client has changed it; `tutti reset` writes it again" in reason
        assert gantry.position("X") == begin_counts + 2000
        assert not any((await client.reset()).values())
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "done" and [step.state for step in report.steps] == ["done", "done"]
        assert gantry.position("X") == begin_counts + 5000

    run_fleet(main, line_fleet("gantry"))


@pytest.mark.parametrize("rest_s", [0, 15])
@pytest.mark.parametrize("make", ["cia402", "ppsmc"])
def test_a_job_waits_at_its_step_for_a_reference_that_a_changed_setting_has_lost(make: str, rest_s: float) -> None:
    """Its axes can be homed by a command meanwhile; until then the step is refused again, whatever is resumed.

    rest_s: the change is found while the step is armed, or at rest before."""
    change = CHANGES[make]
    controller = change.axis.partition(".")[0]
    steps = job(f"[{{do: move, to: {{{change.axis}: 2}}}}, {{do: move, to: {{{change.axis}: 5}}}}]")

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        assert (await outcome(fleet, _prepare(controller))).state == "done"
        job_id = await client.submit(steps)
        await fleet.wait_until(lambda states: states[controller].mode == "moving")
        await client.pause_job(job_id)
        assert await _wait_for_pause(client, job_id) == "paused by anna after step 1"
        motions = len(fleet.controllers[controller].commanded_motions)
        await _change_beside(fleet, change)
        await asyncio.sleep(rest_s)
        for _ in range(2):
            reason = await _resume_in_vain(client, job_id)
            assert "another client has changed it; `tutti reset` writes it again" in reason and "home again" in reason
        assert not any((await client.reset()).values())
        assert f"{change.axis} is not referenced; home it before" in await _resume_in_vain(client, job_id)
        assert len(fleet.controllers[controller].commanded_motions) == motions
        await _home(client, change.axis)
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "done" and [step.state for step in report.steps] == ["done", "done"]

    run_fleet(main, line_fleet(controller))


def test_axes_that_a_waiting_job_lends_are_used_by_commands_only_and_come_back_behind_them() -> None:
    change = CHANGES["cia402"]
    controller = change.axis.partition(".")[0]
    move = job(f"[{{do: move, to: {{{change.axis}: 5}}}}]")

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        assert (await outcome(fleet, _prepare(controller))).state == "done"
        job_id = await client.submit(job(f"[{{do: dwell, duration: 1 s}}, {{do: move, to: {{{change.axis}: 2}}}}]"))
        await asyncio.sleep(0.5)
        await _change_beside(fleet, change)
        assert "home again" in await _wait_for_pause(client, job_id)
        assert not any((await client.reset()).values())
        behind_id = await client.submit(move)
        homing = asyncio.ensure_future(_home(client, change.axis))
        await fleet.wait_until(lambda states: bool(states[controller].axes["r"].homing))
        assert "is in use by anna" in await _resume_in_vain(client, job_id)
        await homing
        await asyncio.sleep(5)
        assert (await client.show_job(behind_id)).entry.state == "queued"
        await client.resume_job(job_id)
        assert (await client.wait_for_job(job_id)).state == "done"

    run_fleet(main, line_fleet(controller))


async def _change_beside(fleet: VirtualFleet, change: Change) -> None:
    """Change a setting as another client does, which asks no adapter."""
    if change.command is None:
        await _change_setting(fleet, change)
        return
    link = await fleet.wires[change.axis.partition(".")[0]].open_link()
    link.write(change.command.encode() + b"\r")


async def _resume_in_vain(client: Tutti, job_id: str) -> str:
    """Resume a job; return why it waits again."""
    await client.resume_job(job_id)
    await asyncio.sleep(1.0)
    reason = await _wait_for_pause(client, job_id)
    assert reason.startswith("waits ") and reason.endswith(f"then `tutti job resume {job_id}`")
    return reason


async def _wait_for_pause(client: Tutti, job_id: str) -> str:
    """Wait until a job is paused; return why."""
    while (change := (await client.show_job(job_id)).transitions[-1]).state != "paused":
        assert change.state not in FINISHED_STATES, change.reason
        await asyncio.sleep(0.1)
    return change.reason
