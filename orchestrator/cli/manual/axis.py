"""`tutti axis …`: manual operation of axes. A motion is a job of one step, leased, checked and recorded; or a jog."""

from math import isfinite
from typing import Any

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.completion import complete_axes, complete_targets
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.speeds import speed_option
from orchestrator.cli.manual.jog.jog import jog
from orchestrator.cli.manual.one_step import run_single_step, wait_option
from orchestrator.cli.manual.take import acquire, release
from orchestrator.cli.view.fleet import stop

_AXES = click.argument("axes", nargs=-1, required=True, shell_complete=complete_axes)


@click.group(epilog='Example: tutti axis move gantry.x=120 stage.u="4500 um" --speed 0.2')
def axis() -> None:
    """List, enable, home, jog and move axes manually."""


@axis.command("ls", epilog="Example: tutti axis ls --json")
@fleet_options
@json_option
def list_axes(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """List all axes: their positions, and the reasons why they are not ready.

    position is in the coordinates of jobs; motor is the same without the offset of `set-position`, which soft limits
    refer to; counts are the controller's own.
    """
    from orchestrator.cli.base.names import require_states
    from orchestrator.client import Tutti
    from orchestrator.monitor.fleet_view import describe_axis
    from orchestrator.monitor.tables import make_plain_table

    async def show_axes(tutti: Tutti) -> None:
        states = await require_states(tutti)
        rows = {f"{c}.{a}": (state, axis_now) for c, state in states.items() for a, axis_now in state.axes.items()}
        if as_json:
            print_json({name: state_now.to_plain() for name, (_, state_now) in rows.items()})
            return
        table = make_plain_table(["axis", "position>", "unit", "motor>", "counts>", "axis is"], ["axis is"])
        for name, (state, axis_state) in rows.items():
            if state.mode == "offline":
                table.add_row(name, "-", axis_state.unit, "-", "-", "offline")
                continue
            user, motor = f"{axis_state.position:,.4f}", f"{axis_state.motor_position:,.4f}"
            table.add_row(
                name,
                user,
                axis_state.unit,
                motor,
                f"{axis_state.raw_counts:,.0f}",
                describe_axis(axis_state, estop=state.estop is not None),
            )
        console.print(table)

    with_fleet(connect, fleet, show_axes)


@axis.command(epilog="Example: tutti axis limits gantry.x")
@_AXES
@fleet_options
@json_option
def limits(axes: tuple[str, ...], connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Show soft limits and largest velocity, acceleration and jerk of AXES (axes, groups or controllers), as their
    adapters report them."""
    from orchestrator.cli.base.names import require_axes
    from orchestrator.client import Tutti

    async def show_limits(tutti: Tutti) -> None:
        axis_infos: dict[str, dict[str, Any]] = {}
        for name in require_axes(await tutti.list_names(), axes):
            config = await tutti.axis_config(name)
            axis_infos[name] = {"unit": config["unit"], "soft_limits": config["soft_limits"], **config["limits"]}
        if as_json:
            print_json(axis_infos)
            return
        for name, info in axis_infos.items():
            ends = info["soft_limits"]
            span = f"{ends['min']} to {ends['max']} {info['unit']}" if ends else "none"
            most = ", ".join(f"{kind} {info[kind]:g}" for kind in ("velocity", "acceleration", "jerk") if info[kind])
            console.print(f"{name}: soft limits {span}; {most} (in {info['unit']} and s)", highlight=False)

    with_fleet(connect, fleet, show_limits)


@axis.command(epilog="Examples: tutti axis enable; tutti axis enable gantry stage.u")
@click.argument("axes", nargs=-1, shell_complete=complete_axes)
@wait_option
@fleet_options
@json_option
def enable(axes: tuple[str, ...], connect: str, fleet: str | None, *, wait: bool, as_json: bool) -> None:
    """Switch the motors of AXES on (axes, groups or controllers); without AXES, those of the whole fleet."""
    from orchestrator.model.fleet_names import WHOLE_FLEET

    step = {"do": "enable", "axes": list(axes) or [WHOLE_FLEET]}
    run_single_step(connect, fleet, step, "enabled", wait=wait, as_json=as_json)


@axis.command(epilog="Examples: tutti axis disable gantry; tutti axis disable all")
@click.argument("axes", nargs=-1, shell_complete=complete_axes)
@wait_option
@fleet_options
@json_option
def disable(axes: tuple[str, ...], connect: str, fleet: str | None, *, wait: bool, as_json: bool) -> None:
    """Switch the motors of AXES off (axes, groups or controllers); `all` stands for those of the whole fleet."""
    if not axes:
        text = "which motors are to be switched off?"
        exit_with_error(text, BAD_INPUT, "name axes, groups or controllers, or write `tutti axis disable all`")
    run_single_step(connect, fleet, {"do": "disable", "axes": list(axes)}, "disabled", wait=wait, as_json=as_json)


@axis.command(epilog="Example: tutti axis home          (the whole fleet, in its home_order)")
@click.argument("axes", nargs=-1, shell_complete=complete_axes)
@wait_option
@fleet_options
@json_option
def home(axes: tuple[str, ...], connect: str, fleet: str | None, *, wait: bool, as_json: bool) -> None:
    """Home AXES, one after the other; without AXES, the whole fleet in its home_order.

    Ctrl-C, a closed terminal, or the end of this process in any other way stops the search.
    """
    run_single_step(
        connect, fleet, {"do": "home", **({"axes": list(axes)} if axes else {})}, "homed", wait=wait, as_json=as_json
    )


@axis.command(epilog='Example: tutti axis move gantry.x=120 stage.u="4500 um" --speed 0.2')
@click.argument("targets", nargs=-1, required=True, metavar="AXIS=VALUE...", shell_complete=complete_targets)
@click.option("--relative", is_flag=True, help="VALUE is a distance, not a position.")
@speed_option
@click.option("--line", is_flag=True, help="Along a straight path.")
@wait_option
@fleet_options
@json_option
def move(
    targets: tuple[str, ...],
    speed: float | str,
    connect: str,
    fleet: str | None,
    *,
    relative: bool,
    line: bool,
    wait: bool,
    as_json: bool,
) -> None:
    """Move axes together to VALUE (with --relative: by VALUE), in the axis's unit or a given unit; VALUE may also be
    the name of a position, as `gantry.x=sample`.

    Ctrl-C, a closed terminal, or the end of this process in any other way stops the axes by their ramps. This is
    software: it is no substitute for a wired emergency stop.
    """
    wanted_targets = parse_targets(targets, "TARGETS")
    step = {
        "do": "move",
        "by" if relative else "to": wanted_targets,
        "speed": speed,
        "sync": "phase" if line else "time",
    }
    run_single_step(connect, fleet, step, "", wait=wait, as_json=as_json)


@axis.command("set-position", epilog='Example: tutti axis set-position gantry.x=0 stage.u="2.5 mm"')
@click.argument("positions", nargs=-1, required=True, metavar="AXIS[=VALUE]...", shell_complete=complete_targets)
@click.option("--clear", is_flag=True, help="Clear the offsets of the AXES: user positions become motor positions.")
@wait_option
@fleet_options
@json_option
def set_position(
    positions: tuple[str, ...], connect: str, fleet: str | None, *, clear: bool, wait: bool, as_json: bool
) -> None:
    """Set the current position of AXIS to VALUE. Nothing moves.

    This sets the user offset of the axis, for all users. Soft limits, which are motor positions, do not shift with
    it.
    """
    axes: dict[str, str | float | None] = {}
    if clear and any("=" in name for name in positions):
        raise click.BadParameter("with --clear name the axes alone, without =VALUE", param_hint="POSITIONS")
    axes |= dict.fromkeys(positions) if clear else parse_targets(positions, "POSITIONS")
    run_single_step(connect, fleet, {"do": "set-position", "axes": axes}, "", wait=wait, as_json=as_json)


# Manual motions are stopped like all others: one stop for all.
axis.add_command(stop)
axis.add_command(jog)
axis.add_command(acquire)
axis.add_command(release)


def parse_targets(targets: tuple[str, ...], what: str) -> dict[str, str | float]:
    """Parse AXIS=VALUE arguments into values by axis."""
    targets_by_name: dict[str, str | float] = {}
    for target in targets:
        name, equals, value = target.partition("=")
        if not equals or not value:
            raise click.BadParameter(f"{target!r}: write AXIS=VALUE, e.g. gantry.x=120", param_hint=what)
        if name in targets_by_name:
            raise click.BadParameter(
                f"{name} is given twice, as {targets_by_name[name]} and as {value}", param_hint=what
            )
        targets_by_name[name] = number = _number_or_text(value)
        if isinstance(number, float) and not isfinite(number):
            raise click.BadParameter(f"{target!r}: {value} is not a position", param_hint=what)
    return targets_by_name


def _number_or_text(value: str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return value
