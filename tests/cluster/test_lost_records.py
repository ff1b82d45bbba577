"""A journal that has lost its last records: what the controllers have done since is never done again."""

import asyncio

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet

from orchestrator.runtime.virtual.fleet import VirtualFleet

MOVE = "[{do: move, by: {gantry.x: 20 mm, stage.u: 5 mm}}]"


def forget_work(fleet: VirtualFleet, job_id: str) -> None:
    """Set the records of a job back to those of its acceptance, as a copy has them that lacks the later ones."""
    db = fleet.journal.database
    db.write("DELETE FROM transitions WHERE job_id = ? AND state != 'queued'", (job_id,))
    db.write("DELETE FROM decisions WHERE job_id = ?", (job_id,))
    db.write("DELETE FROM reports WHERE job_id = ?", (job_id,))
    db.write("UPDATE jobs SET state = 'queued', reason = 'submitted' WHERE id = ?", (job_id,))


@pytest.mark.parametrize("is_over", [False, True], ids=["in its motion", "done"])
def test_a_job_that_a_controller_has_worked_for_is_not_begun_anew(is_over: bool) -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        submitted = await client.submit(job(MOVE))
        if is_over:
            assert (await client.wait_for_job(submitted)).state == "done"
        else:
            await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        fleet.kill("coordinator/first")
        await asyncio.sleep(2.0)
        motions = len(fleet.controllers["gantry"].commanded_motions)
        forget_work(fleet, submitted.id)
        fleet.start_coordinator("second")
        await asyncio.sleep(3.0)
        await client.start_queue()
        report = await client.wait_for_job(submitted)
        assert report.state == "interrupted"
        assert "step 1 of this job, which the journal does not know: it has lost records" in report.reason
        await asyncio.sleep(2.0)
        assert len(fleet.controllers["gantry"].commanded_motions) == motions
        # What was accepted and not begun is run.
        assert (await outcome(fleet, job("[{do: move, by: {gantry.x: -1 mm}}]"))).state == "done"

    run_fleet(main)


def test_a_job_that_nothing_has_worked_for_begins() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        await client.stop_queue()
        submitted = await client.submit(job(MOVE))
        fleet.kill("coordinator/first")
        await asyncio.sleep(2.0)
        fleet.start_coordinator("second")
        await asyncio.sleep(3.0)
        await client.start_queue()
        assert (await client.wait_for_job(submitted)).state == "done"

    run_fleet(main)
