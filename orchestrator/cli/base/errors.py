"""Errors of a command: one rule for the exit code, one form for people on standard error, one for programs.

With `--json` an error is one JSON object on standard output, `{"code", "text", "remedy"}`, and nothing else is.
"""

import asyncio
import json
import os
from collections.abc import Coroutine, Generator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import takewhile
from typing import Any, NoReturn, TypeVar

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, INTERRUPTED, UNREACHABLE
from orchestrator.cli.base.safe_console import SafeConsole

T = TypeVar("T")

errors = SafeConsole(stderr=True)

# Refusals by what they mean for the exit code; every other one is a request that a running fleet refused.
_UNREACHABLE_CODES = {"no-fleet", "no-coordinator", "absent", "no-answer"}
_NAME_CODES = {
    "unknown-name",
    "unknown-axis",
    "unknown-output",
    "unknown-controller",
    "unknown-job",
    "unknown-alarm",
    "ambiguous",
    "bad-unit",
    "bad-name",
    "which-fleet",
    "no-keys",
    "bad-keys",
    "bad-address",
    "key-exists",
    "key-revoked",
    "other-fleet",
    "no-fleet-file",
    "which-key",
    "bad-endpoint",
    "no-user",
    "no-token",
    "bad-user",
    "user-exists",
    "token-exists",
    "weak-password",
    "not-own-address",
    "bad-certificate",
    "no-users",
}
_PLAIN_CODES = {FAILED: "failed", BAD_INPUT: "bad-input", UNREACHABLE: "unreachable", INTERRUPTED: "interrupted"}

_json_wanted: ContextVar[bool] = ContextVar("json_wanted", default=False)


def note_arguments(arguments: Sequence[str]) -> None:
    """Note whether the command is called with `--json`: its errors, those of its usage included, are JSON then."""
    _json_wanted.set("--json" in takewhile(lambda word: word != "--", arguments))


def exit_with_error(
    text: str, exit_code: int = FAILED, remedy: str = "", *, code: str = "", **details: Any
) -> NoReturn:
    """Print the error and its remedy, and exit.

    code: for programs; without, the general one of the exit code. details: further fields of the JSON object.
    """
    if _json_wanted.get():
        fields = {"code": code or _PLAIN_CODES[exit_code], "text": text, "remedy": remedy}
        click.echo(json.dumps({**fields, **details}, indent=2))
        raise SystemExit(exit_code)
    show_error(text, remedy)
    raise SystemExit(exit_code)


def show_error(text: str, remedy: str = "") -> None:
    """Print an error and its remedy for people; the command goes on."""
    from orchestrator.monitor.times import localize_times

    errors.print(f"[bold red]tutti:[/] {escape_markup(localize_times(text))}", highlight=False, soft_wrap=True)
    if remedy:
        errors.print(f"       {escape_markup(remedy)}", highlight=False, soft_wrap=True)


def escape_markup(text: str) -> str:
    """Text that is printed as it is, beside markup."""
    return text.replace("[", "\\[")


def exit_interrupted() -> NoReturn:
    """End an interrupted command."""
    exit_with_error("interrupted", INTERRUPTED)


def exit_with_usage_error(error: click.ClickException) -> NoReturn:
    """Print an error that click has found: in the arguments, or in a file that they name."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    remedy = "" if context is None else f"see `{context.command_path} --help`"
    if isinstance(error, click.NoSuchOption) and context is not None:
        root = context.find_root()
        if any(error.option_name in option.opts for option in root.command.params):
            remedy = f"give it before the command: `{root.command_path} {error.option_name} …`"
    text = error.format_message()
    if isinstance(error, click.exceptions.NoSuchCommand) and context is not None:
        from orchestrator.cli.base.nearest import find_nearest_commands

        commands = find_nearest_commands(context.find_root(), error.command_name)
        # What click suggests stands in the same group; a command of that very name elsewhere is nearer.
        if commands and (commands[0].split()[-1] == error.command_name or "id you mean" not in text):
            nearest = " or ".join(f"`{command}`" for command in commands)
            text = f"no such command {error.command_name!r}; did you mean {nearest}?"
    exit_with_error(text[:1].lower() + text[1:], BAD_INPUT if context is not None else error.exit_code, remedy)


def exit_with_any_error(error: Exception) -> NoReturn:
    """Print an error by the rule; for one that nothing has foreseen, `TUTTI_DEBUG` in the environment shows its
    traceback."""
    _exit_with_known_error(error)
    if os.environ.get("TUTTI_DEBUG"):
        raise error
    exit_with_error(
        f"internal error: {type(error).__name__}: {error}",
        FAILED,
        "this is a fault of Tutti; please report it, with what `TUTTI_DEBUG=1` prints for the same command",
        code="internal",
    )


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
        exit_interrupted()
    except Exception as error:
        _exit_with_known_error(error)
        raise


def refusal_exit_code(code: str) -> int:
    """The exit code for a refusal: 3 when nothing answers, 2 for a name that does not exist, otherwise 1."""
    return UNREACHABLE if code in _UNREACHABLE_CODES else BAD_INPUT if code in _NAME_CODES else FAILED


def _exit_with_known_error(error: Exception) -> None:
    """Print an expected error and exit; return for any other error."""
    # Imported only here: an e-stop must not wait for the loading of all error types.
    from pydantic import ValidationError

    from orchestrator.bus.base import BusError
    from orchestrator.bus.endpoint import BadEndpoint
    from orchestrator.bus.identity import BadIdentity
    from orchestrator.bus.zenoh.sessions import RouterRefused, RouterUnreachable
    from orchestrator.model.errors import Refusal
    from orchestrator.model.jobs.files import FileError
    from orchestrator.model.plugins import PluginError
    from orchestrator.runtime.state.folder import UpFailed

    match error:
        case FileError():
            exit_with_error(str(error), BAD_INPUT, code="bad-file")
        case PluginError():
            exit_with_error(error.text, FAILED, error.remedy, code="plug-in")
        case BadEndpoint():
            exit_with_error(str(error), BAD_INPUT, code="bad-endpoint")
        case BadIdentity():
            exit_with_error(str(error), BAD_INPUT, code="bad-identity")
        case RouterUnreachable() | RouterRefused():
            exit_with_error(str(error), UNREACHABLE, code="no-router")
        case BusError():
            exit_with_error(str(error), UNREACHABLE, "see `tutti status`", code="no-answer")
        case UpFailed():
            exit_with_error(str(error), FAILED, code="not-started")
        case Refusal():
            exit_with_error(error.text, refusal_exit_code(error.code), error.remedy, code=error.code)
        case ValidationError():
            _exit_with_validation_error(error)
        case _:
            pass


def _exit_with_validation_error(error: Any) -> NoReturn:
    """Print which value of a request is not allowed, or that a message of the fleet is not understood."""
    from orchestrator.model.messages import Request
    from orchestrator.model.problems import read_problems

    problem = read_problems(error)[0]
    text = f"{problem.describe('')}, but it is {problem.found!r}"
    if error.title in _names_below(Request):
        exit_with_error(text, BAD_INPUT)
    exit_with_error(
        f"a message of the fleet is not understood: {error.title}: {text}",
        FAILED,
        "start the fleet again with the version of this command (`tutti --version`)",
        code="bad-message",
    )


def _names_below(kind: type) -> set[str]:
    return {kind.__name__}.union(*(_names_below(subclass) for subclass in kind.__subclasses__()))
