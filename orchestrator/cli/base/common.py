"""Shared parts of the commands: connection options, output for people and programs, errors and exit codes."""

import asyncio
import getpass
import json
from collections.abc import Awaitable, Callable, Coroutine, Generator
from contextlib import contextmanager
from typing import Any, NoReturn, TypeVar

import click
from rich.console import Console

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, INTERRUPTED, UNREACHABLE

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])


console = Console()
errors = Console(stderr=True)


def can_redraw() -> bool:
    """Whether the output is a terminal that can show a live screen. A dumb one gets lines."""
    return console.is_terminal and not console.is_dumb_terminal


_UNREACHABLE_CODES = {"no-fleet", "no-coordinator", "absent", "no-answer"}


def fleet_options(command: F) -> F:
    """Add the options `--connect` and `--fleet`."""
    connect = click.option(
        "--connect",
        envvar="TUTTI_CONNECT",
        default="tcp/127.0.0.1:7447",
        show_default=True,
        help="The router, as `tcp/HOST:PORT`.",
    )
    fleet = click.option(
        "--fleet", envvar="TUTTI_FLEET", default=None, callback=_fleet_name, help="The fleet, if there are several."
    )
    return connect(fleet(command))


def _fleet_name(_: click.Context, option: click.Parameter, value: str | None) -> str | None:
    from orchestrator.bus.keys import FleetKeys

    try:
        return value if value is None else FleetKeys(value).fleet
    except ValueError as error:
        raise click.BadParameter(str(error), param=option) from None


json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
processes_option = click.option(
    "--processes", default=1, show_default=True, type=click.IntRange(1, 256), help="Number of parallel processes."
)


def print_json(value: Any) -> None:
    """Print one JSON document on standard output."""
    # Flushed immediately: data left to the end of the interpreter is lost if the process is killed before.
    click.echo(json.dumps(value, indent=2))


def exit_with_error(text: str, code: int = FAILED, remedy: str = "") -> NoReturn:
    """Print the error and its remedy, and exit."""
    errors.print(f"[bold red]tutti:[/] {_strip_markup(text)}", highlight=False, soft_wrap=True)
    if remedy:
        errors.print(f"       {_strip_markup(remedy)}", highlight=False, soft_wrap=True)
    raise SystemExit(code)


def _strip_markup(text: str) -> str:
    return text.replace("[", "\\[")


def run_main(main: Coroutine[Any, Any, T]) -> T:
    """Run `main`; every expected error becomes a message and an exit code."""
    with expected_errors():
        return asyncio.run(main)


@contextmanager
def expected_errors() -> Generator[None]:
    """Turn an interrupt, and every expected error, into a message and an exit code."""
    try:
        yield
    except KeyboardInterrupt:
        errors.print("interrupted")
        raise SystemExit(INTERRUPTED) from None
    except Exception as error:
        _exit_with_known_error(error)
        raise


def _exit_with_known_error(error: Exception) -> None:
    """Print an expected error and exit; return for any other error."""
    # Imported only here: an e-stop must not wait for the loading of all error types.
    from orchestrator.bus.zenoh.sessions import RouterRefused, RouterUnreachable
    from orchestrator.model.errors import Refusal
    from orchestrator.model.files import FileError
    from orchestrator.runtime.live import UpFailed

    match error:
        case FileError():
            exit_with_error(str(error), BAD_INPUT)
        case RouterUnreachable() | RouterRefused():
            exit_with_error(str(error), UNREACHABLE)
        case UpFailed():
            exit_with_error(str(error), FAILED)
        case Refusal():
            code = UNREACHABLE if error.code in _UNREACHABLE_CODES else FAILED
            exit_with_error(f"{error.text} ({error.code})", code, error.remedy)
        case _:
            pass


def with_fleet(connect: str, fleet: str | None, action: Callable[[Any], Awaitable[T]]) -> T:
    """Connect, run `act(tutti)`, and leave the bus in every case."""
    from orchestrator.client import Tutti

    async def run_connected() -> T:
        async with Tutti(connect, fleet, actor=actor_name()) as tutti:
            return await action(tutti)

    return run_main(run_connected())


def actor_name() -> str:
    """Return the user's name, for journals and logs."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown"
