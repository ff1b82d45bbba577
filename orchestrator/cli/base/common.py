"""Shared parts of the commands: connection options, output for people and programs."""

import getpass
import json
import os
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from rich.console import ConsoleDimensions

from orchestrator.bus.endpoint import DEFAULT_ENDPOINT, BadEndpoint, check_endpoint
from orchestrator.cli.base.errors import run_main
from orchestrator.cli.base.safe_console import SafeConsole

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

MAX_ACTOR = 80  # characters, as in a job file
PIPE_COLUMNS = 1000  # a pipe or a file has no width: nothing is cut or wrapped


class _OutputConsole(SafeConsole):
    """A console whose lines are not cut where the output is no terminal."""

    @property
    def size(self) -> ConsoleDimensions:
        columns = os.environ.get("COLUMNS", "")
        if columns.isdecimal() and int(columns) > 0:
            return ConsoleDimensions(int(columns), super().size.height)
        return super().size if self.is_terminal else ConsoleDimensions(PIPE_COLUMNS, 25)

    @size.setter
    def size(self, new_size: tuple[int, int]) -> None:
        self._width, self._height = new_size


console = _OutputConsole()


def can_redraw() -> bool:
    """Whether the output is a terminal that can show a live screen. A dumb one gets lines."""
    return console.is_terminal and not console.is_dumb_terminal


def check_endpoint_option(_: click.Context, option: click.Parameter, value: str) -> str:
    """Check the value of `--connect`; click's callback."""
    try:
        return check_endpoint(value) if value else value
    except BadEndpoint as error:
        raise click.BadParameter(str(error), param=option) from None


def _complete_fleets(context: click.Context, option: click.Parameter, begun: str) -> "list[CompletionItem]":
    from orchestrator.cli.base.completion import complete_fleets

    return complete_fleets(context, option, begun)


connect_option = click.option(
    "--connect",
    envvar="TUTTI_CONNECT",
    default=DEFAULT_ENDPOINT,
    show_default=True,
    show_envvar=True,
    callback=check_endpoint_option,
    help="The router, as `tcp/HOST:PORT`.",
)
state_option = click.option(
    "--state", type=click.Path(path_type=Path), default=None, help="The folder given to `tutti up` as --state."
)


def keys_folder_option(text: str) -> Callable[[F], F]:
    """The option `--keys` of a command that uses keys which are there, with its help."""
    return click.option(
        "--keys",
        type=click.Path(path_type=Path, exists=True, file_okay=False),
        default=None,
        envvar="TUTTI_KEYS",
        show_envvar=True,
        help=text,
    )


def fleet_option(text: str, *, required: bool = False) -> Callable[[F], F]:
    """The option `--fleet`, with its help."""
    return click.option(
        "--fleet",
        envvar="TUTTI_FLEET",
        show_envvar=True,
        default=None,
        required=required,
        callback=check_fleet_option,
        shell_complete=_complete_fleets,
        help=text,
    )


def fleet_options(command: F) -> F:
    """Add the options `--connect`, `--fleet` and `--utc`."""
    return connect_option(fleet_option("The fleet, if there are several.")(utc_option(command)))


def _note_utc(_: click.Context, __: click.Parameter, value: bool) -> None:  # noqa: FBT001
    # The module is imported only if it is needed: an e-stop waits for every import.
    if value or "orchestrator.monitor.times" in sys.modules:
        from orchestrator.monitor.times import show_utc

        show_utc(wanted=value)


def check_fleet_option(_: click.Context, option: click.Parameter, value: str | None) -> str | None:
    """Check the value of `--fleet`; click's callback."""
    from orchestrator.bus.keys import FleetKeys

    try:
        return value if value is None else FleetKeys(value).fleet
    except ValueError as error:
        raise click.BadParameter(str(error), param=option) from None


utc_option = click.option(
    "--utc",
    is_flag=True,
    envvar="TUTTI_UTC",
    show_envvar=True,
    expose_value=False,
    callback=_note_utc,
    help="Show times in UTC, not in local time.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for programs, errors too.")
processes_option = click.option(
    "--processes", default=1, show_default=True, type=click.IntRange(1, 256), help="Number of parallel processes."
)


def print_json(value: Any) -> None:
    """Print one JSON document on standard output."""
    # Flushed immediately: data left to the end of the interpreter is lost if the process is killed before.
    click.echo(json.dumps(value, indent=2))


def print_result(value: Any, words: str, *, as_json: bool) -> None:
    """Print what a command has done: `value` for programs, or `words` for people."""
    print_json(value) if as_json else console.print(words, highlight=False, markup=False, soft_wrap=True)


def with_fleet(connect: str, fleet: str | None, action: Callable[[Any], Awaitable[T]]) -> T:
    """Connect, run `act(tutti)`, and leave the bus in every case."""
    from orchestrator.cli.base.names import explain_absence
    from orchestrator.client import Tutti
    from orchestrator.model.errors import Refusal

    async def run_connected() -> T:
        async with Tutti(connect, fleet, actor=actor_name()) as tutti:
            try:
                return await action(tutti)
            except Refusal as error:
                raise await explain_absence(tutti, error) from None

    return run_main(run_connected())


def actor_name() -> str:
    """Return the user for journals and logs: `TUTTI_ACTOR`, or the user's name."""
    try:
        return (os.environ.get("TUTTI_ACTOR", "").strip() or getpass.getuser())[:MAX_ACTOR]
    except (KeyError, OSError):
        return "unknown"
