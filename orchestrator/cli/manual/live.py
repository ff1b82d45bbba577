"""`tutti live`: moves from a terminal or another program, one by one, as one job."""

import asyncio
import sys
from threading import Thread
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, INTERRUPTED
from orchestrator.cli.base.common import console, fleet_options, json_option, with_fleet
from orchestrator.cli.base.completion import complete_axes
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.manual.one_step import wait_option
from orchestrator.clock.owner import running

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.client.live import LiveJob
    from orchestrator.model.steps.base import Step

MAX_LINES_AHEAD = 90
"""Lines that wait for their turn, below what a live job takes."""


@click.command(epilog="Example: printf 'move gantry.x=10\\nmove gantry.x=20\\n' | tutti live gantry")
@click.argument("axes", nargs=-1, required=True, shell_complete=complete_axes)
@click.option("--name", default="live", show_default=True, help="The name of the job.")
@click.option("--gather", default="0 ms", show_default=True, help="Moves within this time are one synchronised move.")
@wait_option
@fleet_options
@json_option
def live(
    axes: tuple[str, ...], name: str, gather: str, connect: str, fleet: str | None, *, wait: bool, as_json: bool
) -> None:
    """Take AXES (axes, groups or controllers), and do what lines of the input say: move, home, set an output. Moves
    that are there before they begin are chained. It is one job, with a row for each line.

    Lines: `move gantry.x=10 stage.u="2 mm"`, `home`, `set gantry.lamp on`, `wait`, `dwell`, `where`, `stop`, `end`, or
    a step of a job file in JSON; `help` lists them. On a terminal a refused line is shown, and the next one is read;
    elsewhere it ends the job behind the lines before it, with exit code 1; a line that cannot be read, with 2.

    Ctrl-C, a closed terminal, or the end of this process in any other way stops the axes by their ramps. This is
    software: it is no substitute for a wired emergency stop.
    """

    async def run_live(tutti: "Tutti") -> None:
        from orchestrator.cli.jobs.foreground import count_interrupts, follow_unless_interrupted, say

        job = tutti.live(list(axes), name=name, gather=gather, wait=wait)
        with count_interrupts() as interrupts:
            if await follow_unless_interrupted(_run_lines(tutti, job, as_json=as_json), interrupts) is None:
                say("stopping …")
                await job.cancel()
                say("stopped")
                raise SystemExit(INTERRUPTED)

    with_fleet(connect, fleet, run_live)


async def _run_lines(tutti: "Tutti", job: "LiveJob", *, as_json: bool) -> bool:
    """Do what the input says until its end."""
    lines = _Lines()
    async with job:
        if lines.is_terminal:
            console.print(f"live job {job.id}: {' '.join(job.axes)}; `help` lists what a line can say", highlight=False)
        session = _LiveLines(tutti, job, as_json=as_json, goes_on=lines.is_terminal)
        async with running(session.print_results()) as printing:
            while (line := await session.read_unless_failed(lines, printing)) is not None:
                if not await session.take_line(line, lines.number):
                    break
            session.end()
            await printing
            session.fail()
    return True


class _Lines:
    """The lines of standard input, read by a thread: the loop goes on meanwhile."""

    def __init__(self) -> None:
        self.is_terminal = sys.stdin.isatty()
        self.number = 0
        self._loop = asyncio.get_running_loop()
        self._lines: asyncio.Queue[str | None] = asyncio.Queue()
        # A daemon: a terminal that sends no line does not keep the process.
        Thread(target=self._read, name="input", daemon=True).start()

    def _read(self) -> None:
        while True:
            try:
                line = sys.stdin.readline()
            except (OSError, UnicodeError):
                line = ""
            self._loop.call_soon_threadsafe(self._lines.put_nowait, line or None)
            if not line:
                return

    async def read_line(self) -> str | None:
        """The next line; None at the end."""
        line = await self._lines.get()
        self.number += 1
        return line


class _LiveLines:
    """What becomes of lines, in their order. goes_on: also behind a refused one."""

    def __init__(self, tutti: "Tutti", job: "LiveJob", *, as_json: bool, goes_on: bool) -> None:
        self._tutti, self._job, self._as_json, self._goes_on = tutti, job, as_json, goes_on
        self._asked: asyncio.Queue[tuple[Step, int, int] | None] = asyncio.Queue()
        self._room = asyncio.Semaphore(MAX_LINES_AHEAD)
        self._failure: tuple[str, int, str] | None = None

    async def read_unless_failed(self, lines: _Lines, printing: "asyncio.Task[None]") -> str | None:
        """The next line; None at the end of the input, and when a step has failed."""
        async with running(lines.read_line()) as reading:
            await asyncio.wait([reading, printing], return_when=asyncio.FIRST_COMPLETED)
            return reading.result() if reading.done() else None

    async def take_line(self, text: str, number: int) -> bool:
        """Do what a line says, or have it done; return whether another one may come."""
        from orchestrator.cli.manual.live_lines import read_line
        from orchestrator.model.errors import Refusal

        try:
            order = read_line(text, self._job.axes)
        except click.ClickException as error:
            text = f"line {number}: {error.format_message()}"
            return self._note_failure(text, "`help` lists what a line can say", BAD_INPUT)
        match order:
            case None:
                pass
            case "end":
                return False
            case "stop":
                await self._job.stop()
            case "where":
                await self._print_positions()
            case step:
                await self._room.acquire()
                try:
                    (asked_number,) = await self._job.submit(step)
                except Refusal as error:
                    self._room.release()
                    text = f"line {number}: {error.text.removeprefix(f'steps[0] ({step.kind}): ')}"
                    return self._note_failure(text, error.remedy)
                self._asked.put_nowait((step, asked_number, number))
        return True

    def end(self) -> None:
        """No line comes any more."""
        self._asked.put_nowait(None)

    async def print_results(self) -> None:
        """Print what became of each step, in their order, until the end or, where no person sees it, a failure."""
        from orchestrator.client.live import StepFailed
        from orchestrator.model.errors import Refusal

        while (entry := await self._asked.get()) is not None:
            step, asked_number, number = entry
            try:
                report = await self._job.wait_for(asked_number)
            except (Refusal, StepFailed) as error:
                remedy = error.remedy if isinstance(error, Refusal) else ""
                text = error.text if isinstance(error, Refusal) else str(error)
                if not self._note_failure(f"line {number}: {text}", remedy):
                    return
            else:
                if self._as_json:
                    click.echo(report.to_json())
                else:
                    places = [f"{axis} {at.position:.4f} {at.unit}" for axis, at in sorted(report.positions.items())]
                    console.print(f"{step.kind}: {', '.join(places) or report.state}", highlight=False, markup=False)
            self._room.release()

    async def _print_positions(self) -> None:
        from orchestrator.cli.base.positions import describe_positions

        names = await self._tutti.list_names()
        axes = [axis for name in self._job.axes for axis in names.expand_name(name)]
        console.print(describe_positions(await self._tutti.status(), axes), highlight=False, markup=False)

    def fail(self) -> None:
        """End the command if a line has failed."""
        if self._failure is not None:
            text, exit_code, remedy = self._failure
            exit_with_error(text, exit_code, remedy)

    def _note_failure(self, text: str, remedy: str, exit_code: int = FAILED) -> bool:
        """Show a failure to a person; elsewhere it is kept until the lines before it are done. Return whether another
        line may come."""
        if self._goes_on:
            from orchestrator.cli.base.errors import show_error

            show_error(text, remedy)
        else:
            self._failure = text, exit_code, remedy
        return self._goes_on
