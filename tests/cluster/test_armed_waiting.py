"""Steps that wait armed: what starts them, what ends the wait, and how long it is from `go` to T0."""


from cluster.worlds import PREPARE, job, outcome, run_fleet

from orchestrator.client.jobs import SubmittedJob
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.report import JobReport, StepReport
from orchestrator.runtime.virtual.fleet import VirtualFleet


def armed_job(targets: str, terms: str = "") -> str:
    return job(f"[{{do: wait_armed{terms}}}, {{do: move, to: {{{targets}}}}}]")


THERE = armed_job("gantry.x: 20, gantry.y: 10, stage.u: 4")


async def submit_armed(fleet: VirtualFleet, text: str = THERE) -> SubmittedJob:
    """Submit a job; return once its step waits armed."""
    client = fleet.make_client()
    submitted = await client.submit(text)
    while True:
        progress = (await client.show_job(submitted)).progress
        if progress is not None and progress.armed is not None:
            return submitted
        await sleep_ns(fleet.clock, 5 * NS_PER_MS)


def is_loaded(fleet: VirtualFleet) -> bool:
    return any(unit.is_moving(axis) for unit in fleet.controllers.values() for axis in unit.axis_names)


def moved(report: JobReport) -> StepReport:
    return report.steps[-1]


def test_go_starts_all_members_within_the_promise() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await submit_armed(fleet)
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        assert not is_loaded(fleet) and fleet.journal.list_decisions(submitted.id) == []
        t0_ns = await submitted.go()
        report = await submitted.wait()
        assert report.state == "done", report.reason
        step = moved(report)
        assert step.t0_fleet_ns == t0_ns and step.verdict == "green" and step.waited_armed is not None
        assert step.waited_armed.by == "request" and step.waited_armed.lead_ns < 200 * NS_PER_MS, step.waited_armed

    run_fleet(main)
