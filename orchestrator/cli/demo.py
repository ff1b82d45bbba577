"""`tutti demo`: a job on a simulated fleet, from the start of all processes to the report."""

import asyncio
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.codes import FAILED, INTERRUPTED
from orchestrator.cli.base.common import console, json_option, print_json, utc_option
from orchestrator.cli.base.errors import exit_with_error, run_main
from orchestrator.cli.base.pictures import picture_option
from orchestrator.cli.base.systems import require_linux
from orchestrator.cli.view.path_demo import run_path
from orchestrator.clock.signals import call_at_signals
from orchestrator.model.steps.numbers import name_step, number_step

if TYPE_CHECKING:
    from orchestrator.runtime.live.demo_truth import VerdictCheck

JOB_TIMEOUT_S = 120.0  # for the job, which takes six seconds


@click.command(
    epilog="""\b
Examples:
  tutti demo --headless --json | jq .state
  tutti demo --path -o eight.png""",
)
@click.option(
    "--fleet",
    "which",
    type=click.Choice(["two", "all"]),
    default="two",
    show_default=True,
    help="two: an SMC-4000 and an SHRC-203; all: every make, and a trigger wire that starts some of them.",
)
@click.option(
    "--path",
    "as_path",
    is_flag=True,
    help="A figure of eight on an SMC-4000 and two CAN drives instead, in virtual time: the bound, and the truth.",
)
@picture_option("With --path: its picture, of the plan and of what the controllers sampled.")
@click.option("--headless", is_flag=True, help="Show no progress.")
@click.option("-v", "--verbose", is_flag=True, help="Print the report with members and budgets.")
@json_option
@utc_option
@click.option("--keep", type=click.Path(path_type=Path), default=None, help="Keep logs and journal in this folder.")
def demo(
    which: str, keep: Path | None, out: Path | None, *, as_path: bool, headless: bool, verbose: bool, as_json: bool
) -> None:
    """Start router, simulators, adapter hosts and coordinator, run the example job, and print its report.

    The simulated controllers listen on real TCP ports and pseudo-terminals, and record their true motions, which the
    verdicts are checked against. Exit 0 only if the job is done and every start skew is guaranteed within the limit
    of the job; 130 when interrupted.
    """
    if as_path or out is not None:
        run_path(out, wanted=as_path, as_json=as_json)
        return
    require_linux("a fleet", "`tutti demo --path` runs here: one in virtual time")
    from orchestrator.model.jobs.files import load_fleet
    from orchestrator.model.report import JobReport
    from orchestrator.model.templates.template import load_job
    from orchestrator.runtime.examples import find_example
    from orchestrator.runtime.live.demo_truth import check_verdicts
    from orchestrator.runtime.live.fleet import LiveFleet, find_free_port
    from orchestrator.runtime.live.run import FleetRun
    from orchestrator.runtime.state.folder import UpFailed

    def print_line(line: str) -> None:
        if not headless and not as_json:
            console.print(line, highlight=False, markup=False, soft_wrap=True)

    async def run_demo() -> "tuple[JobReport, list[VerdictCheck]]":
        name = "demo" if which == "two" else which
        fleet, job = load_fleet(find_example(f"{name}.fleet.yaml")), load_job(find_example(f"{name}.job.yaml"))
        call_at_signals(_exit_interrupted, ("SIGTERM",))
        with tempfile.TemporaryDirectory(prefix="tutti-demo-") as folder:
            live = LiveFleet(fleet, keep or Path(folder), print_line, FleetRun.make_simulated(find_free_port()))
            await live.start()
            try:
                job_run = asyncio.ensure_future(
                    _run_job(live.connect, fleet.fleet, job, len(fleet.controllers), quiet=headless or as_json)
                )
                assert live.failed is not None
                # A part whose exit code is final would never become ready.
                await asyncio.wait([job_run, live.failed], return_when=asyncio.FIRST_COMPLETED)
                if job_run.done():
                    report, origin_host_ns = await job_run
                    truth = (keep or Path(folder)) / "truth"
                    return report, check_verdicts(fleet, report, truth, origin_host_ns)
                job_run.cancel()
                raise UpFailed(live.failed.result())
            finally:
                await live.close()

    report, truths = run_main(run_demo())
    unsure = [step for step in report.steps if step.verdict not in ("green", "none")]
    if as_json:
        print_json(make_summary(report) | {"truth": [check._asdict() for check in truths]})
    else:
        from orchestrator.monitor.report_table import make_report_tables

        console.print(make_report_tables(report, detailed=verbose))
        _print_truths(truths, proven=report.state == "done" and not unsure)
    # For programs the summary says all of it.
    if report.state != "done" or (unsure and as_json):
        raise SystemExit(FAILED)
    if unsure:
        names = ", ".join(f"{number_step(step.index)} ({step.verdict})" for step in unsure)
        exit_with_error(
            f"the start skew cannot be guaranteed within the limit of the job in step {names}",
            remedy="the machine was perhaps too busy to read the controllers' replies in time; try again",
        )


def _print_truths(truths: "list[VerdictCheck]", *, proven: bool) -> None:
    """Print how the stated starts compare with the simulators' record. proven: each start is within its limit."""
    for check in truths:
        holds = "within what is stated above" if check.held else "[yellow]outside what is stated above[/]"
        axes_outside = f"; outside their stated starts: {', '.join(check.outside)}" if check.outside else ""
        console.print(
            f"{name_step(check.step)}: by the simulators' own record the axes started within "
            f"{check.skew_ns / 1e6:.2f} ms of each other, {holds}{axes_outside}",
            soft_wrap=True,
        )
    if proven:
        console.print(
            "done: controllers of different makers moved together; a bound on the difference of their starts was "
            "stated before each move and proven after it.\n"
            "next: `tutti up deploy/examples/demo.fleet.yaml --sim` keeps such a fleet running, and "
            "docs/tutorial/first-quarter-hour.md is a tour of it",
            soft_wrap=True,
        )
    if not all(check.held and not check.outside for check in truths):
        console.print("Simulated controllers react late on a busy machine, unlike real ones.")


async def _run_job(connect: str, fleet: str, job: Any, controllers: int, *, quiet: bool) -> tuple[Any, int]:
    """Wait until the fleet is adopted, then submit and follow the job; return also the host instant at which fleet
    time is 0."""
    from orchestrator.cli.jobs.follow import follow_job
    from orchestrator.client import Tutti
    from orchestrator.runtime.readiness import find_origin_host_ns, wait_until_adopted
    from orchestrator.runtime.state.folder import UpFailed

    async with Tutti(connect, fleet, actor="demo") as tutti:
        await wait_until_adopted(tutti, controllers)
        job_id = await tutti.submit(job)
        try:
            async with asyncio.timeout(JOB_TIMEOUT_S):
                report = await follow_job(tutti, job_id, quiet=quiet)
        except TimeoutError:
            raise UpFailed(f"job {job_id} has not ended after {JOB_TIMEOUT_S:g} s; see the logs with --keep") from None
        return report, await find_origin_host_ns(tutti)


def make_summary(report: Any) -> dict[str, Any]:
    """Return the report as one object: state, and each step's members, start skew, budget and durations."""
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


def _exit_interrupted() -> None:
    raise SystemExit(INTERRUPTED)
