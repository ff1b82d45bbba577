"""`tutti log`: the log lines of all processes of a fleet."""

import json
import re
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from orchestrator.cli.base.codes import BAD_INPUT, UNREACHABLE
from orchestrator.cli.base.common import actor_name, console, fleet_option, json_option, state_option, utc_option
from orchestrator.cli.base.completion import complete_controllers
from orchestrator.cli.base.durations import DurationType
from orchestrator.cli.base.errors import errors, exit_with_error, refusal_exit_code
from orchestrator.cli.base.jobs import JobReferenceType
from orchestrator.cli.base.state import choose_state

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from orchestrator.monitor.logs.placing import PlacedLine
    from orchestrator.monitor.logs.words import LineLayout

FOLLOW_S = 0.25  # between two readings of the files
PRINTED_AT_ONCE = 200  # lines


@click.command(
    epilog="""\b
Examples:
  tutti log --level warning --since 10min
  tutti log --job last
  tutti log --controller gantry --follow"""
)
@state_option
@fleet_option("The fleet, if there are several; it need not run.")
@click.option("--job", type=JobReferenceType(), default=None, help="Only lines of this job.")
@click.option("--controller", default=None, shell_complete=complete_controllers, help="Only lines of this controller.")
@click.option(
    "--level",
    type=click.Choice(["info", "warning"]),
    default="info",
    show_default=True,
    help="This level and above; faults, losses and e-stops are warnings.",
)
@click.option("--since", type=DurationType(), default=None, help="Only lines of this last time, e.g. 10min.")
@click.option("--last", type=click.IntRange(1), default=None, help="Only that many, the newest.")
@click.option("--follow", is_flag=True, help="Continue with new lines until Ctrl-C.")
@utc_option
@json_option
def log(
    state: Path | None,
    fleet: str | None,
    job: str | None,
    controller: str | None,
    level: Literal["info", "warning"],
    since: float | None,
    last: int | None,
    *,
    follow: bool,
    as_json: bool,
) -> None:
    """Show the log lines of all processes of a fleet on this computer, in order of fleet time.

    Reads the files in the state folder: the fleet need not run. JOB: the beginning of its id; its name, or `last`, if
    the fleet runs. Lines of standard error have no time: they stand at the time when their file was written last.
    """
    from orchestrator.monitor.logs.files import LogFolder
    from orchestrator.monitor.logs.filter import LogFilter
    from orchestrator.monitor.logs.words import LineLayout

    folder = choose_state(state, fleet, "log", "logs")
    since_ns = None if since is None else time.time_ns() - round(since * 1e9)
    wanted_filter = LogFilter(None if job is None else _resolve_job(folder, job), controller, level, since_ns)
    with closing(LogFolder(folder / "log")) as files:
        lines = _read(files.read_all)
        shown_lines = [line for line in lines if wanted_filter.accepts(line)]
        shown_lines = shown_lines if last is None else shown_lines[-last:]
        layout = None if as_json else LineLayout(shown_lines)
        _print_lines(shown_lines, layout)
        _report_damage(lines)
        while follow:
            time.sleep(FOLLOW_S)
            added_lines = _read(files.read_added)
            _print_lines([line for line in added_lines if wanted_filter.accepts(line)], layout)
            _report_damage(added_lines)


def _read(read: "Callable[[], list[PlacedLine]]") -> "list[PlacedLine]":
    try:
        return read()
    except OSError as error:
        text = f"{error.filename or 'the log'} cannot be read: {error.strerror}"
        exit_with_error(text, BAD_INPUT, "choose another folder with --state, or run this as the user of the fleet")


def _resolve_job(folder: Path, reference: str) -> str:
    """The id of a job, asked of the fleet if it answers; otherwise the reference is the beginning of the id."""
    import asyncio

    from orchestrator.bus.base import BusError
    from orchestrator.bus.zenoh.sessions import RouterUnreachable
    from orchestrator.client import Tutti
    from orchestrator.model.errors import Refusal
    from orchestrator.runtime.state.folder import find_running_fleet

    running_fleet = find_running_fleet(folder)

    async def find_job(connect: str, name: str) -> str:
        async with Tutti(connect, name, actor=actor_name()) as tutti:
            return (await tutti.find_job(reference)).id

    if running_fleet is not None:
        try:
            return asyncio.run(find_job(running_fleet.connect, running_fleet.fleet))
        except (BusError, RouterUnreachable):
            pass
        except Refusal as error:
            if refusal_exit_code(error.code) != UNREACHABLE:
                raise
    if re.fullmatch("[0-9a-f]+", reference) is None:
        text = f"job {reference!r} cannot be looked up: no fleet answers"
        exit_with_error(text, UNREACHABLE, "write the beginning of its id", code="no-answer")
    return reference


def _print_lines(lines: "Sequence[PlacedLine]", layout: "LineLayout | None") -> None:
    """Print them for people; without a layout for programs, one JSON object a line."""
    from orchestrator.monitor.logs.words import make_plain_line

    for at in range(0, len(lines), PRINTED_AT_ONCE):
        part = lines[at : at + PRINTED_AT_ONCE]
        if layout is None:
            console.out("\n".join(json.dumps(make_plain_line(line)) for line in part), highlight=False)
        else:
            console.print(*map(layout.format_line, part), sep="\n", soft_wrap=True)


def _report_damage(lines: "Sequence[PlacedLine]") -> None:
    """Say on standard error how many lines could not be read, of which files."""
    damaged_files = [line.line.file for line in lines if line.line.damaged]
    for name in dict.fromkeys(damaged_files):
        errors.print(
            f"{damaged_files.count(name)} damaged lines in {name}, shown as they are", highlight=False, style="dim"
        )
