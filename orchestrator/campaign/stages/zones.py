"""Keep-out zones in the fault campaign: two carriages of two makes that face each other, and jobs that go near them.

Positions of an axis are shares of its speed limit: a carriage stands at `BASE` or goes out to `OUT`, before a wall.
Both cannot be out at once, and the second one not while the third axis, which carries nothing, is out.
"""

from collections.abc import Mapping, Sequence
from random import Random
from typing import Any, NamedTuple

from orchestrator.campaign.stages.fleet_parts import find_traits
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.queue import QueueTerms
from orchestrator.model.zone_fields import find_relation_axis
from orchestrator.plan.zones.course import find_margin

BASE, OUT = 0.1, 0.9
OVERLAP = 0.32  # of the smaller speed limit: by how much both would be too far out
HALF_WAY = 0.5
HYSTERESIS = 0.05
RANGE = (-0.2, 1.7)  # of an axis whose position is not known
SIZE, DISTANCE = 20.0, 5.0  # of carriages, and between them, mm
WALL, WALL_DISTANCE = 10.0, 3.0  # the thickness of a wall, and how far a carriage stays from it, mm
CLEAR = 0.05  # mm: what is left behind all margins where a carriage goes near something
FOLLOWING_ERROR = 0.3  # mm: how far an axis may be from its command, which is its margin
TRUE_ERRORS = (0.6, 0.9)  # of that: how much farther out than its motor an axis is by truth
BEYOND = 0.5  # of the margin: how much too far a step goes that must be refused
ZONE_SPEED = 0.17
SWAP_SHARE = 0.6  # of the way on which one may wait for the other
SWAP_CHANCE = 0.3
NEAR_CHANCE = 0.4
DWELL_CHANCE = 0.5
LATER_CHANCE = 0.8  # that the carriage of `member` goes first
SWAP, TOO_FAR = "swap", "beyond"
"""Jobs that a zone may refuse, and must refuse."""


class ZoneCell(NamedTuple):
    """The axes of a fleet with zones. first, second: of the carriages; third: excludes the second one."""

    first: str
    second: str
    third: str


class ZoneJob(NamedTuple):
    """A job to be made. axes: those that it moves."""

    name: str
    steps: list[dict[str, Any]]
    terms: QueueTerms
    axes: tuple[str, ...]


def add_zones(fleet: Fleet, makes: Sequence[str], seed: int) -> Fleet:
    """The fleet with zones of the first axes of the first controllers of three makes."""
    draw, plain = Random(f"zones {seed}"), fleet.to_plain()
    plain.pop("wiring", None)
    names = [next(name for name, config in fleet.controllers.items() if config.adapter == make) for make in makes]
    cell = ZoneCell(*(f"{name}.{next(iter(fleet.controllers[name].axes))}" for name in names))
    for label in cell:
        name, axis = label.split(".")
        _complete_axis(plain["controllers"][name], axis, draw)
    return _add_rules(Fleet.model_validate(plain), cell)


def _complete_axis(config: dict[str, Any], name: str, draw: Random) -> None:
    """State where an axis that can carry a body has its reference, its margin, and its error by truth."""
    axis, simulate = config["axes"][name], config["simulate"]
    body = find_traits(config["adapter"]).body
    if body is None:
        return
    axis["homing"] = {**axis["homing"], **body.homing}
    simulate["options"] = {**simulate.get("options", {}), **body.simulate}
    axis["following_error"] = FOLLOWING_ERROR
    velocity, error = axis["limits"]["velocity"], FOLLOWING_ERROR * draw.uniform(*TRUE_ERRORS)
    errors = [[HALF_WAY * velocity, 0.0], [(OUT - BASE) * velocity, error]]
    simulate["mechanics"] = {name: {"errors": errors}}


def _add_rules(fleet: Fleet, cell: ZoneCell) -> Fleet:
    """The fleet with bodies on two axes, and rules."""
    speeds = [fleet.axis(axis).limits.velocity for axis in cell]
    outs = [OUT * speed for speed in speeds]
    reach = outs[0] + outs[1] - OVERLAP * min(speeds[:2])  # of both positions together
    margins = [find_margin(fleet.axis(axis)) for axis in cell]
    offset = (SIZE + WALL) / 2 + WALL_DISTANCE + CLEAR
    facing = reach + SIZE + DISTANCE  # where the second carriage stands at 0
    carriage, wall = {"box": [SIZE, SIZE, SIZE]}, {"box": [WALL, 2 * SIZE, 2 * SIZE]}
    first_wall = {**wall, "at": [outs[0] + margins[0] + offset, 0, 0]}
    second_wall = {**wall, "at": [facing - outs[1] - margins[1] - offset, 0, 0]}
    rules = {
        "carriages": {"apart": {"bodies": ["first", "second"], "distance": DISTANCE}},
        "first-wall": {"keep_out": {"body": "first", "region": first_wall, "distance": WALL_DISTANCE}},
        "second-wall": {"keep_out": {"body": "second", "region": second_wall, "distance": WALL_DISTANCE}},
        "third-out": {
            "when": f"{cell.third} > {HALF_WAY * speeds[2]:g} {fleet.axis(cell.third).unit}",
            "forbid": f"{cell.second} > {HALF_WAY * speeds[1]:g} mm",
            "hysteresis": HYSTERESIS * speeds[2],
        },
    }
    bodies = {
        "first": {**carriage, "at": [0, 0, 0], "on": [{"axis": cell.first, "along": "x"}]},
        "second": {**carriage, "at": [facing, 0, 0], "on": [{"axis": cell.second, "along": [-1, 0, 0]}]},
    }
    ranges = {axis: [share * speed for share in RANGE] for axis, speed in zip(cell, speeds, strict=True)}
    zones = {"bodies": bodies, "rules": rules, "ranges": ranges, "homes_away": list(cell)}
    return Fleet.model_validate({**fleet.to_plain(), "zones": zones})


def find_cell(fleet: Fleet) -> ZoneCell | None:
    """The axes of a fleet with zones, None: it has none."""
    if fleet.zones is None:
        return None
    first, second = (fleet.zones.bodies[name].on[0].axis for name in ("first", "second"))
    relation = fleet.zones.rules["third-out"].when
    assert first is not None and second is not None and relation is not None
    return ZoneCell(first, second, find_relation_axis(relation))


def carries_a_body(fleet: Fleet, controller: str) -> bool:
    """Whether a fault of the stage can affect a controller: it moves a carriage, or there are none."""
    cell = find_cell(fleet)
    return cell is None or controller in map(controller_of, cell[:2])


def draw_zone_jobs(fleet: Fleet, member: str, positions: Mapping[str, float], draw: Random) -> list[ZoneJob]:
    """Draw jobs of the carriages, that of `member` first: to and fro beside each other, of which one waits for the
    other, or both in one step. positions: of each axis, in its unit."""
    cell = find_cell(fleet)
    assert cell is not None
    main, partner = cell[:2] if controller_of(cell.first) == member else (cell.second, cell.first)
    speeds = {axis: fleet.axis(axis).limits.velocity for axis in cell}
    outs = {axis: round(OUT * speed, 3) for axis, speed in speeds.items()}
    bases = {axis: round(BASE * speed * draw.uniform(0.5, 1.0), 3) for axis, speed in speeds.items()}
    margins = {axis: find_margin(fleet.axis(axis)) for axis in cell}
    # So far the partner may go while the main one is out.
    limit = outs[partner] - OVERLAP * min(speeds[main], speeds[partner]) - margins[main] - margins[partner] - 2 * CLEAR
    third_job = ZoneJob("late", [_move(outs, cell.third), _move(bases, cell.third)], QueueTerms(), (cell.third,))
    excess = {main: outs[main] + CLEAR + BEYOND * margins[main]}
    excess_job = ZoneJob(TOO_FAR, [_move(excess, main)], QueueTerms(priority=-1), (main,))
    if draw.random() < SWAP_CHANCE:
        begin = {
            partner: round(draw.uniform(bases[partner], bases[partner] + SWAP_SHARE * (limit - bases[partner])), 3)
        }
        targets = {main: bases[main], partner: outs[partner]}
        swap = {"do": "move", "to": targets, "speed": ZONE_SPEED, "sync": "time"}
        steps = [_move(outs, main), _move(begin, partner), swap, _move(bases, partner)]
        return [ZoneJob(SWAP, steps, QueueTerms(), (main, partner)), third_job, excess_job]
    steps = [_move(outs, main), _move(bases, main)]
    if draw.random() < DWELL_CHANCE:
        steps.insert(draw.randrange(2), {"do": "dwell", "duration": f"{draw.randrange(1000)} ms"})
    partner_job = _draw_partner(partner, limit, outs, bases, draw)
    return [ZoneJob("main", steps, QueueTerms(), (main,)), partner_job, third_job, excess_job]


def _draw_partner(
    axis: str, limit: float, outs: Mapping[str, float], bases: Mapping[str, float], draw: Random
) -> ZoneJob:
    """Draw the job of the other carriage: out, in the way of the main one, or to a limit in front of it; and back."""
    targets = {axis: round(limit, 3)} if draw.random() < NEAR_CHANCE else outs
    terms = QueueTerms(repeat=draw.choice((1, 2)), priority=draw.choice((0, 5)))
    steps = [_move(targets, axis), _move(bases, axis)]
    if draw.random() < LATER_CHANCE:
        steps.insert(0, {"do": "dwell", "duration": f"{draw.randrange(200, 1500)} ms"})
    return ZoneJob("beside", steps, terms, (axis,))


def _move(targets: Mapping[str, float], axis: str) -> dict[str, Any]:
    return {"do": "move", "to": {axis: targets[axis]}, "speed": ZONE_SPEED}


def find_way_back(fleet: Fleet, axis: str, position: float) -> float | None:
    """Where a move that zones always allow takes an axis that they depend on; None for any other axis."""
    if axis not in (find_cell(fleet) or ()):
        return None
    velocity = fleet.axis(axis).limits.velocity
    return round(position / 2 if position > BASE * velocity else position + BASE * velocity / 2, 3)
