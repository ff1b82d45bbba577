"""`tutti demo`: a job on a simulated fleet, from nothing to the report."""

import asyncio
import signal
import tempfile
from pathlib import Path
from typing import Any

import click

from orchestrator.cli.codes import FAILED, INTERRUPTED
from orchestrator.cli.common import console, fail, json_option, print_json, run

READY_S = 30.0  # for all controllers to be adopted; a second on a machine with nothing else to do
LOOK_S = 0.05
JOB_S = 120.0  # for the job, which takes six seconds

EXAMPLES = Path(__file__).resolve().parents[2] / "deploy" / "examples"


@click.command(epilog="Example: tutti demo --headless --json | jq .state")
@click.option("--headless", is_flag=True, help="Show nothing while it runs.")
@json_option
@click.option("--keep", type=click.Path(path_type=Path), default=None, help="Keep logs and journal in this folder.")
def demo(headless: bool, as_json: bool, keep: Path | None) -> None:
    """Start router, simulators, adapter hosts and coordinator, run the example job, and print its report.

    The fleet is a simulated Yaskawa SMC-4000 on TCP and a simulated OptoSigma SHRC-203 on a pseudo-terminal. Exit 0
    only if the job is done and every start skew is surely within what the job allows; 130 when interrupted.
    """
    from orchestrator.lab.live import LiveFleet, UpFailed, free_port
    from orchestrator.model.files import load_fleet, load_job
    from orchestrator.model.report import JobReport

    def say(line: str) -> None:
        if not headless and not as_json:
            console.print(line, highlight=False, markup=False, soft_wrap=True)

    async def main() -> JobReport:
        fleet, job = load_fleet(EXAMPLES / "demo.fleet.yaml"), load_job(EXAMPLES / "demo.job.yaml")
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, _interrupt)
        with tempfile.TemporaryDirectory(prefix="tutti-demo-") as folder:
            live = LiveFleet(fleet, keep or Path(folder), say, port=free_port(), simulated=True)
            await live.start()
            try:
                job_run = asyncio.ensure_future(
                    _run_job(live.connect, fleet.fleet, job, len(fleet.controllers), headless or as_json)
                )
                assert live.failed is not None
                # A part that ends for good would be waited for in vain.
                await asyncio.wait([job_run, live.failed], return_when=asyncio.FIRST_COMPLETED)
                if job_run.done():
                    return await job_run
                job_run.cancel()
                raise UpFailed(live.failed.result())
            finally:
                await live.close()

    report = run(main())
    unsure = [step for step in report.steps if step.verdict not in ("green", "none")]
    if as_json:
        print_json(summary(report))
    else:
        from orchestrator.monitor.report_table import report_tables

        console.print(report_tables(report))
    if report.state != "done":
        raise SystemExit(FAILED)
    if unsure:
        names = ", ".join(f"{step.index} ({step.verdict})" for step in unsure)
        fail(
            f"the start skew is not surely within what the job allows in step {names}",
            remedy="the machine was perhaps too busy to take the controllers' answers in time; try again",
        )


async def _run_job(connect: str, fleet: str, job: Any, controllers: int, quiet: bool) -> Any:
    """Wait until the fleet is adopted, then submit and follow."""
    from orchestrator.cli.follow import follow
    from orchestrator.client import Tutti
    from orchestrator.lab.live import UpFailed
    from orchestrator.model.state import ControllerState

    async with await Tutti.connect(connect, fleet, actor="demo") as tutti:
        states: dict[str, ControllerState] = {}
        try:
            async with asyncio.timeout(READY_S):
                while len(states) < controllers or not all(s.epoch and s.mode == "idle" for s in states.values()):
                    states = await tutti.status()
                    await asyncio.sleep(LOOK_S)
        except TimeoutError:
            shown = ", ".join(f"{name} is {state.mode}" for name, state in states.items()) or "none answers"
            raise UpFailed(f"not all controllers are ready within {READY_S:g} s: {shown}") from None
        job_id = await tutti.submit(job)
        try:
            async with asyncio.timeout(JOB_S):
                return await follow(tutti, job_id, quiet)
        except TimeoutError:
            raise UpFailed(f"job {job_id} has not ended within {JOB_S:g} s; look at the logs with --keep") from None


def summary(report: Any) -> dict[str, Any]:
    """The report as one object: state, and each step's members, start skew, budget and durations."""
    steps: list[dict[str, Any]] = []
    for step in report.to_plain()["steps"]:
        steps.append(
            {
                "index": step["index"],
                "do": step["do"],
                "name": step["name"],
                "state": step["state"],
                "members": step["members"],
                "start_skew": step["start_skew"],
                "budget": step["budget"],
                "end_skew": step["end_skew"],
                "verdict": step["verdict"],
                "planned_s": step["planned_s"],
                "actual_s": step["actual_s"],
            }
        )
    return {"state": report.state, "reason": report.reason, "job_id": report.job_id, "steps": steps}


def _interrupt() -> None:
    raise SystemExit(INTERRUPTED)
