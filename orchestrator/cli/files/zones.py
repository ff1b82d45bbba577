"""`tutti zones …`: keep-out zones of a fleet file."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import fleet_options, json_option, print_result, with_fleet
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.pictures import picture_option, write_picture
from orchestrator.cli.files.fleet import load_or_fail
from orchestrator.cli.manual.axis import parse_targets

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.fleet import Fleet
    from orchestrator.model.operation.zone_state import RuleReading
    from orchestrator.plan.zones.rules import FleetZones

CHECKED = (
    "moves, paths, scans, probes and homing, in `tutti job check`, in dry runs, and before each step; "
    "jogs of axes that have a reference"
)
NOT_CHECKED = (
    "jogs of axes without a reference, homing of `homes_away`, and what other programs move, "
    "which a running coordinator watches and stops"
)


@click.group(epilog="Example: tutti zones check lab.fleet.yaml")
def zones() -> None:
    """Keep-out zones: bodies that ride on axes, and rules of what must not collide. Software, no safety function."""


@zones.command(epilog="Example: tutti zones check lab.fleet.yaml --at gantry.x=120")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--at", multiple=True, metavar="AXIS=VALUE", help="Where a real axis stands; default: 0. Repeat it for others."
)
@json_option
def check(file: Path, at: tuple[str, ...], *, as_json: bool) -> None:
    """List the bodies and rules of FILE, and how far apart bodies are. Nothing is connected.

    Positions are motor positions, like soft limits. Exit 1 when a rule is broken there.
    """
    from orchestrator.plan.zones.observation import observe_zones

    fleet, fleet_zones = _load_zones(file)
    positions = {**dict.fromkeys(fleet_zones.ranges, 0.0), **_read_positions(fleet, at)}
    readings = observe_zones(fleet, fleet_zones, positions, {}).rules
    value = {
        "bodies": {name: body.axes for name, body in fleet_zones.bodies.items()},
        "positions": positions,
        "margins": fleet_zones.margins,
        "rules": {
            reading.rule: {
                "holds": reading.holds is True,
                "distance_mm": reading.distance,
                "trust_step": reading.trust_step,
                "text": reading.text,
            }
            for reading in readings
        },
        "homing_order": _find_homing_order(fleet, fleet_zones),
        "checked": CHECKED,
        "not_checked": NOT_CHECKED,
    }
    print_result(value, "\n".join(_describe(file, fleet, fleet_zones, positions, readings)), as_json=as_json)
    if not all(reading.holds for reading in readings):
        raise SystemExit(FAILED)


@zones.command(epilog="Example: tutti zones plot lab.fleet.yaml --at gantry.x=120 -o zones.png")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--at", multiple=True, metavar="AXIS=VALUE", help="Where a real axis stands; default: 0. Repeat it for others."
)
@picture_option("Where to write the picture; default: zones.png.")
@json_option
def plot(file: Path, at: tuple[str, ...], out: Path | None, *, as_json: bool) -> None:
    """Draw the bodies and regions of FILE. Nothing is connected.

    From above, from the front, from the side and in space; what is nearer than allowed is red. Exit 1 when a rule is
    broken there.
    """
    from orchestrator.monitor.zones_plot import plot_zones
    from orchestrator.plan.zones.observation import observe_zones

    fleet, fleet_zones = _load_zones(file)
    positions = {**dict.fromkeys(fleet_zones.ranges, 0.0), **_read_positions(fleet, at)}
    state = observe_zones(fleet, fleet_zones, positions, {})
    standing = ", ".join(f"{name} {position:g} {fleet.axis(name).unit}" for name, position in positions.items())
    path = out or Path("zones.png")
    write_picture(plot_zones(state, f"{fleet.fleet}: {standing}"), path)
    value = {"written": str(path), "rules": [rule.to_plain() for rule in state.rules]}
    print_result(value, f"written: {path}", as_json=as_json)
    if any(rule.holds is False for rule in state.rules):
        raise SystemExit(FAILED)


@zones.command(epilog="Example: tutti zones show --json | jq .rules")
@fleet_options
@json_option
def show(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Show what each rule says to where the axes of the running fleet are.

    By the last states, without their uncertainty. Exit 1 when a rule is broken.
    """

    async def show_zones(tutti: "Tutti") -> None:
        state = await tutti.zone_state()
        if not state.rules:
            exit_with_error("this fleet has no `zones`", BAD_INPUT, "see the page on keeping axes apart for their form")
        lines = [f"{len(state.bodies)} bodies, {len(state.rules)} rules:"]
        lines += [f"  {rule.rule}: {rule.verdict}: {rule.text}" for rule in state.rules]
        lines.append("Zones are software, no safety function.")
        print_result(state.to_plain(), "\n".join(lines), as_json=as_json)
        if any(rule.holds is False for rule in state.rules):
            raise SystemExit(FAILED)

    with_fleet(connect, fleet, show_zones)


def _load_zones(file: Path) -> "tuple[Fleet, FleetZones]":
    from orchestrator.plan.zones.rules import FleetZones

    fleet = load_or_fail(file)
    if fleet.zones is None:
        exit_with_error(f"{file} has no `zones`", BAD_INPUT, "see the page on keeping axes apart for their form")
    return fleet, FleetZones(fleet)


def _read_positions(fleet: "Fleet", at: tuple[str, ...]) -> dict[str, float]:
    from orchestrator.model.units import UnitError, parse_quantity

    positions: dict[str, float] = {}
    for name, value in parse_targets(at, "--at").items():
        text = fleet.names.explain_unknown(name, "axis")
        if text is not None:
            exit_with_error(f"--at: {text}", BAD_INPUT, "correct the name")
        try:
            positions[name] = float(parse_quantity(value, fleet.axis(name).unit, name))
        except UnitError as error:
            exit_with_error(f"--at {name}: {error}", BAD_INPUT, "correct the unit")
    return positions


def _find_homing_order(fleet: "Fleet", zones: "FleetZones") -> list[str] | None:
    """An order in which all axes of rules can be homed, none of which has a reference; None: there is none."""
    from orchestrator.plan.zones.homing import ZoneHoming

    return ZoneHoming(zones, fleet, {}).find_order(list(zones.ranges))


def _describe(
    file: Path,
    fleet: "Fleet",
    zones: "FleetZones",
    positions: dict[str, float],
    readings: "Sequence[RuleReading]",
) -> list[str]:
    lines = [f"{file}: {len(zones.bodies)} bodies, {len(zones.rules)} rules", "bodies:"]
    for name, body in zones.bodies.items():
        carriers = f"rides on {', '.join(body.axes)}" if body.axes else "stands still"
        lines.append(f"  {name}: {carriers}")
    standing = ", ".join(f"{name} {position:g} {fleet.axis(name).unit}" for name, position in positions.items())
    lines.append(f"rules, with {standing}:")
    for reading in readings:
        trust = "; relies on the axes of a step (trust_step)" if reading.trust_step else ""
        lines.append(f"  {reading.rule}: {reading.verdict}: {reading.text}{trust}")
    order = _find_homing_order(fleet, zones)
    order_text = "none; home some of them, move them away, and home the others" if order is None else ", ".join(order)
    lines.append(f"order of homing, where no axis has a reference: {order_text}")
    margins = ", ".join(f"{name} {margin:.3g} {fleet.axis(name).unit}" for name, margin in zones.margins.items())
    lines += [
        f"uncertainty of positions (following_error, a count, play): {margins}",
        f"checked: {CHECKED}",
        f"not checked yet: {NOT_CHECKED}",
        "Zones are software, no safety function.",
    ]
    return lines
