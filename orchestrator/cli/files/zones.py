"""`tutti zones …`: keep-out zones of a fleet file."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import json_option, print_result
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.files.fleet import load_or_fail
from orchestrator.cli.manual.axis import parse_targets

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet
    from orchestrator.plan.zones.rules import FleetZones

CHECKED = (
    "moves, paths, scans, probes and homing, in `tutti job check`, in dry runs, and before each step; "
    "jogs of axes that have a reference"
)
NOT_CHECKED = (
    "jogs of axes without a reference, homing of `homes_away`, and what other programs move; "
    "actual positions are not watched"
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
    from orchestrator.plan.zones.rules import FleetZones

    fleet = load_or_fail(file)
    if fleet.zones is None:
        exit_with_error(f"{file} has no `zones`", BAD_INPUT, "see the page on keeping axes apart for their form")
    fleet_zones = FleetZones(fleet)
    positions = {**dict.fromkeys(fleet_zones.ranges, 0.0), **_read_positions(fleet, at)}
    states = fleet_zones.find_states(positions)
    broken_rules = [state.rule for state in states if not state.holds]
    value = {
        "bodies": {name: body.axes for name, body in fleet_zones.bodies.items()},
        "positions": positions,
        "margins": fleet_zones.margins,
        "rules": {
            state.rule: {
                "holds": state.holds,
                "distance_mm": state.distance,
                "trust_step": state.trust_step,
                "text": state.text,
            }
            for state in states
        },
        "homing_order": _find_homing_order(fleet, fleet_zones),
        "checked": CHECKED,
        "not_checked": NOT_CHECKED,
    }
    print_result(value, "\n".join(_describe(file, fleet, fleet_zones, positions)), as_json=as_json)
    if broken_rules:
        raise SystemExit(FAILED)


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


def _describe(file: Path, fleet: "Fleet", zones: "FleetZones", positions: dict[str, float]) -> list[str]:
    lines = [f"{file}: {len(zones.bodies)} bodies, {len(zones.rules)} rules", "bodies:"]
    for name, body in zones.bodies.items():
        carriers = f"rides on {', '.join(body.axes)}" if body.axes else "stands still"
        lines.append(f"  {name}: {carriers}")
    standing = ", ".join(f"{name} {position:g} {fleet.axis(name).unit}" for name, position in positions.items())
    lines.append(f"rules, with {standing}:")
    for state in zones.find_states(positions):
        trust = "; relies on the axes of a step (trust_step)" if state.trust_step else ""
        lines.append(f"  {state.rule}: {'holds' if state.holds else 'BROKEN'}: {state.text}{trust}")
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
