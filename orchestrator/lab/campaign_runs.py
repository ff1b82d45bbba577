"""Seeds of the fault campaign: for each a fleet of some makes, a fault at a stage of its step, and what came of it."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from random import Random
from typing import Any

from orchestrator.lab import sync_fleets as makes
from orchestrator.lab.campaign import FAULTS, STAGES, Story, run_seed
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Job

LEAST, MOST = 3, 5  # controllers of a fleet
PACE = 0.15  # of the speed limits: nobody is there by chance before a fault comes
CRUISE_S = 8.0

_MAKERS: dict[str, Callable[[int], dict[str, Any]]] = {
    "smc4000": makes.smc4000,
    "smc2000": makes.smc2000,
    "shrc203": makes.shrc203,
    "smc30": lambda number: makes.smc30(100, number + 1),  # all of a fleet on one bus
    "ppsmc": makes.ppsmc,
}


@dataclass(slots=True)
class Campaign:
    """What was found. cells: seeds by stage, fault and make of the member that it befell."""

    first: int
    seeds: int = 0
    violations: dict[int, list[str]] = field(default_factory=dict[int, list[str]])
    cells: Counter[tuple[str, str, str]] = field(default_factory=Counter[tuple[str, str, str]])
    controllers: list[int] = field(default_factory=list[int])
    fleet_s: float = 0.0
    controller_s: float = 0.0


def fleet_of(seed: int) -> Fleet:
    """Controllers of random makes, with crystals of their own."""
    draw = Random(f"fleet {seed}")
    plain: dict[str, Any] = {}
    for number in range(draw.randint(LEAST, MOST)):
        make = draw.choice(list(_MAKERS))
        config = _MAKERS[make](number)
        crystal = {
            "offset_s": draw.uniform(0, 600),
            "drift_ppm": draw.uniform(-makes.DRIFT_PPM, makes.DRIFT_PPM),
            "wander_ppm": makes.WANDER_PPM,
        }
        plain[f"{make}-{number}"] = {**config, "simulate": {**config["simulate"], **crystal}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "campaign", "controllers": plain})


def jobs_of(fleet: Fleet) -> tuple[Job, Job]:
    """One that enables and homes everything, and one that moves it for some seconds."""
    names = list(fleet.controllers)
    targets = {f"{name}.x": fleet.controllers[name].axes["x"].limits.velocity * PACE * CRUISE_S for name in names}
    return _job([{"do": "enable", "axes": names}, {"do": "home"}]), _job([{"do": "move", "to": targets, "speed": PACE}])


def _job(steps: list[dict[str, Any]]) -> Job:
    plain = {"schema": "tutti.job/1", "name": "campaign", "max_start_skew": "100 ms", "max_end_skew": "1 s"}
    return Job.model_validate({**plain, "steps": steps})


def play(seed: int) -> tuple[Story, Fleet]:
    """One seed. Seeds walk through all pairs of stage and fault; the fleet, and what is random, come from the seed."""
    stage = STAGES[seed % len(STAGES)]
    fault = FAULTS[(seed // len(STAGES)) % len(FAULTS)]
    fleet = fleet_of(seed)
    prepare, move = jobs_of(fleet)
    return run_seed(fleet, prepare, move, seed, stage, fault), fleet


def run_campaign(seeds: Iterable[int], told: Callable[[Story], None] = lambda _: None) -> Campaign:
    """Play seeds one after the other; `told` hears of each."""
    found: Campaign | None = None
    for seed in seeds:
        found = found or Campaign(seed)
        story, fleet = play(seed)
        found.seeds += 1
        found.cells[story.stage, story.fault, fleet.controllers[story.member].adapter] += 1
        found.controllers.append(len(fleet.controllers))
        found.fleet_s += story.fleet_s
        found.controller_s += story.fleet_s * len(fleet.controllers)
        if story.violations:
            found.violations[seed] = story.violations
        told(story)
    assert found is not None
    return found
