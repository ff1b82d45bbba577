"""Probes in the fault campaign: the inputs that stop axes, and jobs with a probe."""

from collections.abc import Mapping
from random import Random
from typing import Any

from orchestrator.campaign.stages.fleet_parts import PROBE_NAME, TOUCH_INPUT, find_traits
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.probe import Probe

PROBE_SPEED = 0.05  # of the speed limit
BACK_SPEED = 0.17
PROBE_S = (1.5, 3.0)  # of its way, without a contact
MIDDLE_S = 0.75  # of the soft limits, at the speed limit
DIGITS = 4  # of a target
LINE_AXIS = "y"
LINE_CHANCE = 0.6  # of a make that stops several axes on a line, where there are several
HOST_CHANCE = 0.25  # of a make whose controllers stop an axis by themselves, each on a link of its own


def add_touch_inputs(fleet: Fleet) -> Fleet:
    """The fleet with an input for probes at each controller that can have one, in the place of the one that starts it,
    and without wires for that; and with a second axis where two can probe on a line."""
    plain = fleet.to_plain()
    plain.pop("wiring", None)
    for config in plain["controllers"].values():
        touch = find_traits(config["adapter"]).touch
        if touch is not None:
            inputs = {name: point for name, point in config.get("inputs", {}).items() if name != "start"}
            config["inputs"] = {**inputs, TOUCH_INPUT: {"number": touch.number, "active": touch.active}}
            if touch.line_motor is not None and len(config["axes"]) == 1:
                (axis,) = config["axes"].values()
                config["axes"][LINE_AXIS] = {**axis, "motors": [touch.line_motor]}
    return Fleet.model_validate(plain)


def draw_probe(fleet: Fleet, member: str, positions: Mapping[str, float], draw: Random) -> list[dict[str, Any]]:
    """Draw a probe of the first axis of `member`, or of several on a line, and the way back to where it began.
    positions: of each axis, in its unit."""
    traits = find_traits(fleet.controllers[member].adapter)
    assert traits.touch is not None
    begins, ends = draw_ends(fleet, member, positions, draw)
    # A poll of one of several on a link takes longer than a probe by its host allows.
    by_host = traits.touch.stops_by == "host" or (
        draw.random() < HOST_CHANCE and traits.most_per_link == 1 and len(ends) == 1
    )
    probe = {
        "do": "probe",
        "name": PROBE_NAME,
        "to": ends,
        "until": f"{member}.{TOUCH_INPUT}",
        "speed": PROBE_SPEED,
        "by": "host" if by_host else "controller",
        "else": "continue",
    }
    return [probe, {"do": "move", "to": begins, "speed": BACK_SPEED}]


def draw_ends(
    fleet: Fleet, member: str, positions: Mapping[str, float], draw: Random
) -> tuple[dict[str, float], dict[str, float]]:
    """Draw which axes of `member` probe: where they stand, and where they go to at most."""
    touch, axes = find_traits(fleet.controllers[member].adapter).touch, fleet.controllers[member].axes
    names = [f"{member}.{name}" for name in axes]
    is_line = touch is not None and touch.line_motor is not None and len(names) > 1 and draw.random() < LINE_CHANCE
    begins, ends = dict[str, float](), dict[str, float]()
    for name in names if is_line else names[:1]:
        begin, velocity = round(positions[name], DIGITS), fleet.axis(name).limits.velocity
        way = velocity * PROBE_SPEED * draw.uniform(*PROBE_S)
        begins[name] = begin
        ends[name] = round(begin + (way if begin < MIDDLE_S * velocity else -way), DIGITS)
    return begins, ends


def find_probe(job: Job) -> Probe | None:
    """The probe of a job, None: it has none."""
    return next((step for step in job.steps if isinstance(step, Probe)), None)
