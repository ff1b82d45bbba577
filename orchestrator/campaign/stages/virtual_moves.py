"""Virtual axes of the fault campaign's fleets, and their moves."""

from collections.abc import Mapping
from fractions import Fraction
from random import Random

from orchestrator.campaign.stages.fleet_parts import VIRTUAL_GROUP
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.move import Move

PARTS = (Fraction(-2, 5), Fraction(1, 5), Fraction(0), Fraction(3, 10))
"""Of one real axis in a virtual one that stands for another."""
DIGITS = 4  # of a target, mm
VIRTUAL_SPEED = 0.5
"""Of the speed limits."""
WAYS_S = (0.9, 1.6)  # at that speed
MIDDLE_S = 0.75  # of the soft limits, at the speed limit


def add_virtual_axes(fleet: Fleet, seed: int) -> Fleet:
    """The fleet with virtual axes: one for the first axis of each controller, and for parts of the others."""
    draw = Random(f"virtual {seed}")
    axes = [f"{name}.{next(iter(config.axes))}" for name, config in fleet.controllers.items()]
    matrix = {
        f"v{row}": [str(Fraction(1) if row == column else draw.choice(PARTS)) for column in range(len(axes))]
        for row in range(len(axes))
    }
    group = {"of": axes, "matrix": matrix, "axes": {name: {"unit": "mm"} for name in matrix}}
    return Fleet.model_validate({**fleet.to_plain(), "virtual": {VIRTUAL_GROUP: group}})


def draw_virtual_targets(fleet: Fleet, positions: Mapping[str, float], draw: Random) -> dict[str, float]:
    """Draw targets of all virtual axes, by name: ways of unequal length of their real axes, from `positions` in their
    units, within their soft limits."""
    virtual_map = fleet.virtual_axes.maps[VIRTUAL_GROUP]
    real: list[Fraction] = []
    for axis in virtual_map.real:
        velocity = fleet.axis(axis).limits.velocity
        way = velocity * VIRTUAL_SPEED * draw.uniform(*WAYS_S)
        real.append(Fraction(positions[axis] + (way if positions[axis] < MIDDLE_S * velocity else -way)))
    targets = zip(virtual_map.virtual, virtual_map.to_virtual(real), strict=True)
    return {name: round(float(value), DIGITS) for name, value in targets}


def find_virtual_move(job: Job) -> Move | None:
    """The move of virtual axes of a job, None: it has none."""
    moves = (step for step in job.steps if isinstance(step, Move))
    return next((step for step in moves if any(name.startswith(f"{VIRTUAL_GROUP}.") for name in step.to)), None)
