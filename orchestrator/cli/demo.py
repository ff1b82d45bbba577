"""`tutti demo`: a job on a simulated fleet, from nothing to the report."""

import asyncio
import signal
import tempfile
from pathlib import Path
from typing import Any

import click

from orchestrator.cli.common import FAILED, INTERRUPTED, console, json_option, print_json, run

EXAMPLES = Path(__file__).resolve().parents[2] / "deploy" / "examples"


@click.command(epilog="Example: tutti demo --headless --json | jq .state")
@click.option("--headless", is_flag=True, help="Show nothing while it runs.")
@json_option
@click.option("--keep", type=click.Path(path_type=Path), default=None, help="Keep logs and journal in this folder.")
def demo(headless: bool, as_json: bool, keep: Path | None) -> None:
    """Start router, simulators, adapter hosts and coordinator, run the example job, and print its report.

    The fleet is a simulated Yaskawa SMC-4000 on TCP and a simulated OptoSigma SHRC-203 on a pseudo-terminal. Exit 0
    only if the job is done and every start skew is surely within what the job allows.
    """
    from orchestrator.lab.live import LiveFleet, free_port
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
                return await _run_job(live.connect, fleet.fleet, job, len(fleet.controllers), headless or as_json)
            finally:
                await live.close()

    report = run(main())
    good = report.state == "done" and all(step.verdict in ("green", "none") for step in report.steps)
    if as_json:
        print_json(summary(report))
    else:
        from orchestrator.monitor.report_table import report_tables

        console.print(report_tables(report))
    if not good:
        raise SystemExit(FAILED)


async def _run_job(connect: str, fleet: str, job: Any, controllers: int, quiet: bool) -> Any:
    """Wait until the fleet is adopted, then submit and follow."""
    from orchestrator.cli.follow import follow
    from orchestrator.client import Tutti

    async with await Tutti.connect(connect, fleet, actor="demo") as tutti:
        async with asyncio.timeout(30):
            while True:
                states = await tutti.status()
                if len(states) == controllers and all(s.epoch and s.mode == "idle" for s in states.values()):
                    break
                await asyncio.sleep(0.05)
        return await follow(tutti, await tutti.submit(job), quiet)


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
