"""`tutti sim …`: simulated controllers."""

from pathlib import Path

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, json_option, print_json
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.sim.campaign import campaign
from orchestrator.cli.sim.serve import serve
from orchestrator.cli.sim.world import limit, power, push, put_contact, set_analog, set_input, stall


@click.group(epilog="Example: tutti sim input gantry.door active")
def sim() -> None:
    """Simulated controllers: serve them, check them against test vectors, change the environment of running ones."""


for command in (set_input, set_analog, limit, power, push, put_contact, stall, serve, campaign):
    sim.add_command(command)


@sim.command(epilog="Example: tutti sim check shrc203 shrc203.vectors.jsonl --only shrc203-001")
@click.argument("model")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--only", default=None, help="Run the one vector with this id.")
@json_option
def check(model: str, file: Path, only: str | None, *, as_json: bool) -> None:
    """Run the test vectors in FILE against a fresh simulated MODEL, in virtual time. Exit 0 only if none failed."""
    from sim.core.vectors import check_file

    try:
        report = check_file(model, file, only)
    except ValueError as error:
        exit_with_error(str(error), BAD_INPUT)
    failures = [failure for failure_list in report.failures.values() for failure in failure_list]
    if as_json:
        print_json(
            {
                "passed": len(report.passed),
                "failed": len(report.failures),
                "failures": [
                    {name: getattr(failure, name) for name in ("vector", "lines", "sent", "expected", "received")}
                    for failure in failures
                ],
            }
        )
    else:
        for failure in failures:
            console.print(f"{failure.vector} ({failure.lines})", style="bold", highlight=False, markup=False)
            for name in ("sent", "expected", "received"):
                value = repr(failure.sent) if name == "sent" else getattr(failure, name)
                console.print(f"  {name:9}{value}", highlight=False, markup=False, soft_wrap=True)
        console.print(f"{len(report.passed)} passed, {len(report.failures)} failed", highlight=False)
    if report.failures:
        raise SystemExit(FAILED)
