"""`tutti position …`: named positions, saved and used."""

from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, print_result, with_fleet
from orchestrator.cli.base.completion import complete_axes, complete_positions, complete_targets
from orchestrator.cli.base.speeds import speed_option
from orchestrator.cli.manual.axis import parse_targets
from orchestrator.cli.manual.one_step import run_single_step, wait_option

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.positions.entries import PositionEntry

_NAME = click.argument("name", shell_complete=complete_positions)
_AXES = click.argument("axes", nargs=-1, shell_complete=complete_axes)


@click.group(epilog="Example: tutti position save sample gantry stage.u")
def position() -> None:
    """Save positions under names, and move to them.

    They are user positions, like the targets of jobs. A job takes them by name, `to: sample` or
    `to: {gantry.x: sample}`, with the values of the moment at which it begins.
    """


@position.command(epilog='Example: tutti position save sample gantry stage.u --description "under the objective"')
@click.argument("name")
@_AXES
@click.option(
    "--at",
    multiple=True,
    metavar="AXIS=VALUE",
    shell_complete=complete_targets,
    help="A value that is saved instead of where the axis is; repeat it for others.",
)
@click.option("--description", default=None, help="What it is, for lists.")
@fleet_options
@json_option
def save(
    name: str,
    axes: tuple[str, ...],
    at: tuple[str, ...],
    description: str | None,
    connect: str,
    fleet: str | None,
    *,
    as_json: bool,
) -> None:
    """Save where AXES (axes, groups or controllers) are as the position NAME; without AXES and --at, all axes that are
    referenced.

    A saved position of this name is replaced; one of the fleet file is covered until `tutti position rm`.
    """
    values = parse_targets(at, "--at")

    async def save_position(tutti: "Tutti") -> None:
        saved_position = await tutti.save_position(name, *axes, at=values, description=description)
        covers = "; it covers the position of the fleet file" if saved_position.covers_file else ""
        print_result(
            saved_position.to_plain(), f"{name} is saved: {_describe_axes(saved_position)}{covers}", as_json=as_json
        )

    with_fleet(connect, fleet, save_position)


@position.command("ls", epilog="Example: tutti position ls --json")
@fleet_options
@json_option
def list_positions(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """List all named positions: those of the fleet file, and those that are saved."""
    from orchestrator.monitor.tables import make_plain_table

    async def show_positions(tutti: "Tutti") -> None:
        positions = await tutti.list_positions()
        if as_json:
            print_json([entry.to_plain() for entry in positions])
            return
        table = make_plain_table(["position", "axes", "from", "description"], ["axes", "description"])
        for entry in positions:
            table.add_row(entry.name, _describe_axes(entry), _describe_source(entry), entry.description)
        console.print(table)
        for entry in positions:
            for problem in entry.problems:
                console.print(f"{entry.name} cannot be used: {problem}", style="yellow", highlight=False, markup=False)

    with_fleet(connect, fleet, show_positions)


@position.command(epilog="Example: tutti position show sample")
@_NAME
@fleet_options
@json_option
def show(name: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Show the position NAME: its axes, where it is from, and what is wrong with it."""
    from orchestrator.cli.base.names import unknown_name

    async def show_position(tutti: "Tutti") -> None:
        known_positions = {entry.name: entry for entry in await tutti.list_positions()}
        if name not in known_positions:
            raise unknown_name("position", name, known_positions, "see `tutti position ls`")
        entry = known_positions[name]
        if as_json:
            print_json(entry.to_plain())
            return
        lines = [f"{name}: {_describe_source(entry)}", *([entry.description] if entry.description else [])]
        lines += [f"  {axis} {value}" for axis, value in entry.axes.items()]
        lines += [f"cannot be used: {problem}" for problem in entry.problems]
        for line in lines:
            console.print(line, highlight=False, markup=False, soft_wrap=True)

    with_fleet(connect, fleet, show_position)


@position.command(epilog="Example: tutti position goto sample stage.u --speed 0.1")
@_NAME
@_AXES
@speed_option
@wait_option
@fleet_options
@json_option
def goto(
    name: str, axes: tuple[str, ...], speed: float | str, connect: str, fleet: str | None, *, wait: bool, as_json: bool
) -> None:
    """Move the axes of the position NAME there, or only AXES of it (axes, groups or controllers).

    Ctrl-C, a closed terminal, or the end of this process in any other way stops the axes by their ramps.
    """
    to = dict.fromkeys(axes, name) if axes else name
    run_single_step(connect, fleet, {"do": "move", "to": to, "speed": speed}, "", wait=wait, as_json=as_json)


@position.command("rm", epilog="Example: tutti position rm sample")
@_NAME
@fleet_options
@json_option
def remove(name: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Remove the saved position NAME; one of the fleet file with this name counts again."""

    async def remove_position(tutti: "Tutti") -> None:
        uncovered_position = await tutti.remove_position(name)
        note = (
            ""
            if uncovered_position is None
            else f"; that of the fleet file counts again: {_describe_axes(uncovered_position)}"
        )
        value = {"removed": name, "uncovered": None if uncovered_position is None else uncovered_position.to_plain()}
        print_result(value, f"{name} is removed{note}", as_json=as_json)

    with_fleet(connect, fleet, remove_position)


def _describe_axes(entry: "PositionEntry") -> str:
    return ", ".join(f"{axis} {value}" for axis, value in entry.axes.items())


def _describe_source(entry: "PositionEntry") -> str:
    from orchestrator.monitor.times import format_time

    if entry.source == "file":
        return "fleet file"
    origin = "saved" if entry.utc is None else f"{entry.actor}, {format_time(entry.utc)}"
    return origin + (" (covers the fleet file's)" if entry.covers_file else "")
