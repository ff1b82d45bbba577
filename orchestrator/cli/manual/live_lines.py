"""The lines of `tutti live`: words as those of the commands, or a step as a job file has it, in JSON."""

import json
import shlex
from typing import Any, Literal

import click

from orchestrator.cli.base.speeds import speed_option
from orchestrator.cli.manual.axis import parse_targets
from orchestrator.model.steps.base import Step

Order = Literal["where", "stop", "end"]
"""What is done at once."""

_AXES = click.argument("axes", nargs=-1)


@click.group(name="", add_help_option=False, options_metavar="")
def live_lines() -> None:
    """What a line can say; a line that begins with `{` is a step of a job file, in JSON."""


@live_lines.command(epilog='Example: move gantry.x=120 stage.u="4500 um" --speed 0.2')
@click.argument("targets", nargs=-1, required=True, metavar="AXIS=VALUE...")
@click.option("--relative", is_flag=True, help="VALUE is a distance, not a position.")
@click.option("--line", is_flag=True, help="Along a straight path.")
@speed_option
def move(targets: tuple[str, ...], speed: float | str, *, relative: bool, line: bool) -> Step:
    """Move axes together to VALUE."""
    values = parse_targets(targets, "TARGETS")
    sync = "phase" if line else "time"
    return _make_step({"do": "move", "by" if relative else "to": values, "speed": speed, "sync": sync})


@live_lines.command()
@_AXES
def home(axes: tuple[str, ...]) -> Step:
    """Home AXES; without them, all of this live job."""
    return _make_step({"do": "home", "axes": _expand_axes(axes)})


@live_lines.command()
@_AXES
def enable(axes: tuple[str, ...]) -> Step:
    """Switch the motors of AXES on; without them, all of this live job."""
    return _make_step({"do": "enable", "axes": _expand_axes(axes)})


@live_lines.command()
@_AXES
def disable(axes: tuple[str, ...]) -> Step:
    """Switch the motors of AXES off; without them, all of this live job."""
    return _make_step({"do": "disable", "axes": _expand_axes(axes)})


@live_lines.command("set", epilog="Example: set gantry.lamp on")
@click.argument("output", metavar="CONTROLLER.OUTPUT")
@click.argument("state", type=click.Choice(["on", "off"]))
def set_output(output: str, state: str) -> Step:
    """Switch a named output."""
    return _make_step({"do": "output", "output": output, "value": state == "on"})


@live_lines.command(epilog='Example: wait gantry.door on --timeout "10 s"')
@click.argument("name", metavar="CONTROLLER.INPUT")
@click.argument("state", type=click.Choice(["on", "off"]))
@click.option("--timeout", default="10 s", show_default=True, help="After it, the step fails.")
def wait(name: str, state: str, timeout: str) -> Step:
    """Wait until an input is active, or passive."""
    return _make_step({"do": "wait", "input": name, "value": state == "on", "timeout": timeout})


@live_lines.command(epilog='Example: dwell "0.5 s"')
@click.argument("duration")
def dwell(duration: str) -> Step:
    """Wait, as a step of the fleet's own."""
    return _make_step({"do": "dwell", "duration": duration})


@live_lines.command()
def where() -> Order:
    """Print where the axes are now."""
    return "where"


@live_lines.command()
def stop() -> Order:
    """Stop what moves, and forget the lines that wait."""
    return "stop"


@live_lines.command()
def end() -> Order:
    """End behind the lines that wait, as the end of the input does."""
    return "end"


def read_line(text: str, axes: list[str]) -> Step | Order | None:
    """What a line says; None: nothing. axes: of the live job. Raises `click.ClickException`."""
    line = text.strip()
    if not line or line.startswith("#"):
        return None
    if line.startswith("{"):
        try:
            return _make_step(json.loads(line))
        except (ValueError, RecursionError) as error:
            raise click.UsageError(f"no JSON: {error}") from None
    try:
        words = shlex.split(line)
    except ValueError as error:
        raise click.UsageError(f"{line!r}: {error}") from None
    if words[0] in ("help", "?"):
        click.echo(_describe_lines())
        return None
    with click.Context(live_lines, info_name="", obj=axes) as context:
        name, command, arguments = live_lines.resolve_command(context, words)
        assert command is not None
        return command.main(arguments, prog_name=name, standalone_mode=False, obj=axes)


def _describe_lines() -> str:
    context = click.Context(live_lines, info_name="")
    rows = [
        f"  {' '.join(command.collect_usage_pieces(context)):40} {command.get_short_help_str(60)}"
        for command in live_lines.commands.values()
    ]
    names = list(live_lines.commands)
    return "\n".join(f"  {name:8}{row[2:]}" for name, row in zip(names, rows, strict=True))


def _expand_axes(axes: tuple[str, ...]) -> list[str]:
    return list(axes) or list(click.get_current_context().obj)


def _make_step(fields: Any) -> Step:
    from pydantic import TypeAdapter, ValidationError

    from orchestrator.model.problems import first_error_text
    from orchestrator.model.steps.live import AskedStep

    adapter: TypeAdapter[Step] = TypeAdapter(AskedStep)
    try:
        return adapter.validate_python(fields)
    except ValidationError as error:
        raise click.UsageError(first_error_text(error).removeprefix("Value error, ")) from None
