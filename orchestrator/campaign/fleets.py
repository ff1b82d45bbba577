"""Fleets of the fault campaign: controllers of random makes, with varied crystals, links, hosts and trigger wires."""

from collections.abc import Callable, Collection, Sequence
from random import Random
from typing import Any

from orchestrator.campaign.recording.recorder import Stage
from orchestrator.campaign.stages.fleet_parts import TRIGGER_NUMBER, TRIGGER_OUTPUT, find_traits
from orchestrator.campaign.stages.hall import HALL_MAKE, make_hall_fleet
from orchestrator.campaign.stages.pairs import add_pair
from orchestrator.campaign.stages.probes import add_touch_inputs
from orchestrator.campaign.stages.virtual_moves import add_virtual_axes
from orchestrator.campaign.stages.zones import add_zones, carries_a_body
from orchestrator.model.fleet import Fleet
from orchestrator.runtime import simulated_fleets as makes
from orchestrator.runtime.example_fleet import load_example
from sim.core.campaign import CampaignTraits

MAKES = ("smc4000", "smc2000", "shrc203", "ppsmc", "smc30", "cia402")

LEAST, MOST = 4, 6  # controllers of a fleet
SHARED_LINK_CHANCE = 0.6  # chance that a make whose controllers can share a link has several on it
PERMIT = "door"
PERMIT_MAKE = "smc4000"
"""The make that has the permit's input. The first controller of this make in a fleet has it."""
PATH_MAKE = "smc4000"
"""A make that executes paths in chunks."""
SYNC_MAKE = "cia402"
"""A make whose drives follow the SYNCs of their host."""
PATH_JERK = 20_000  # of a drive that follows a path, unit/s³
TRIGGER_MAKE = "smc4000"
"""The make whose controllers have an output with triggers."""
AT_ONCE_MAKES = ("smc4000", "shrc203", "ppsmc", "smc30")
"""The makes whose controllers start steps at once."""
PAIR_MAKES = (PATH_MAKE, SYNC_MAKE)
"""The makes of two axes that carry one beam."""
BODY_MAKES = tuple(make for make in MAKES if find_traits(make).body is not None)
"""The makes whose axes carry bodies of zones."""
TOUCH_MAKES = tuple(make for make in MAKES if find_traits(make).touch is not None)
"""The makes whose axes are stopped by an input."""
STAGE_MAKES: dict[Stage, tuple[str, ...]] = {
    "chunk": (PATH_MAKE, "cia402"),
    "trigger": (TRIGGER_MAKE,),
    "at-once": AT_ONCE_MAKES,
    "flying": (PATH_MAKE, "cia402"),
    "pair": PAIR_MAKES,
    "probe": TOUCH_MAKES,
    "zone": BODY_MAKES,
}
"""The makes that can reach a stage, where not all can."""
HOME_AT_CURRENT_POSITION = "37"  # of CiA 402: the reference is the current position of the axis

HOME_ANYWHERE = (HOME_AT_CURRENT_POSITION, "index", "index_negative")
"""Homing methods whose reference depends on where the axis stands."""

# Slower than the default rate, as with many controllers on one computer. A permit's controller is polled more often.
_POLL_RATES = {"idle_hz": 1.25, "moving_hz": 5.0}
_PERMIT_POLL_RATES = {"idle_hz": 3.0, "moving_hz": 5.0}
# Homing has a short path, and the edge of a switch lies between two index pulses.
_SHORT_HOMING = {"axes": 2, "home_edge": {"X": -50, "Y": -30}, "index_every": {"X": 20, "Y": 20}}
_DRIVE_LIMITS = {"velocity": 80, "acceleration": 400}
_DRIVE = {"unit": "mm", "scale": 1000, "limits": _DRIVE_LIMITS}

FleetDraft = dict[str, dict[str, Any]]


def _draft_smc4000(number: int, units: int, draw: Random) -> FleetDraft:
    config = makes.make_smc4000(number)
    config["simulate"]["options"] = _SHORT_HOMING
    if draw.random() < 0.3:
        config["axes"]["y"] = {**config["axes"]["x"], "motors": ["Y"]}
    config["outputs"] = {"start": {"number": 1}, TRIGGER_OUTPUT: {"number": TRIGGER_NUMBER}}
    config["inputs"] = {**config["inputs"], PERMIT: {"number": 2, "active": "low"}}
    return {f"a{number}": config}


def _draft_smc2000(number: int, units: int, draw: Random) -> FleetDraft:
    drafts = {f"b{number}-{unit}": makes.make_smc2000(number, unit) for unit in range(units)}
    if units == 1:
        drafts = {f"b{number}": makes.make_smc2000(number)}
    for config in drafts.values():
        config["simulate"]["options"] = _SHORT_HOMING
    return drafts


def _draft_shrc203(number: int, units: int, draw: Random) -> FleetDraft:
    return {f"c{number}": makes.make_shrc203(number)}


def _draft_ppsmc(number: int, units: int, draw: Random) -> FleetDraft:
    config = makes.make_ppsmc(number)
    config["simulate"]["options"] = {"axes": 1, "org_steps": {"1": [-9000, -200]}}
    return {f"d{number}": config}


def _draft_smc30(number: int, units: int, draw: Random) -> FleetDraft:
    drafts = {f"e{number}-{unit}": makes.make_smc30(number, unit) for unit in range(1, units + 1)}
    for config in drafts.values():
        config["simulate"]["options"] = {"checksum": True, "travel_steps": [-200, 400_000]}
    return drafts


def _draft_cia402(number: int, units: int, draw: Random) -> FleetDraft:
    """Draft drives on one CAN bus, which take their current position as reference."""
    drafts: FleetDraft = {}
    options = {"state_ms": draw.choice((50, 100, 150)), "inhibit_ms": draw.choice((10, 20, 40))}
    event_ms = draw.choice((10, 20, 40))
    for unit in range(1, units + 1):
        link = {"kind": "can", "interface": "socketcan", "channel": f"can{number}", "address": unit}
        drafts[f"f{number}-{unit}"] = {
            "adapter": "cia402",
            "link": link,
            "options": options,
            "axes": {"x": {**_DRIVE, "motors": ["1"], "homing": {"method": HOME_AT_CURRENT_POSITION}}},
            "simulate": {"options": {"event_ms": event_ms}, "decode_us": 300, "spread_us": 200},
        }
    return drafts


_DRAFTS: dict[str, Callable[[int, int, Random], FleetDraft]] = {
    "smc4000": _draft_smc4000,
    "smc2000": _draft_smc2000,
    "shrc203": _draft_shrc203,
    "ppsmc": _draft_ppsmc,
    "smc30": _draft_smc30,
    "cia402": _draft_cia402,
}


def makes_with(has: Callable[[CampaignTraits], bool]) -> tuple[str, ...]:
    """Return the makes of the campaign with a property."""
    return tuple(make for make in MAKES if has(find_traits(make)))


def _draft_other(make: str, number: int) -> FleetDraft:
    """Draft a controller of a make that the campaign does not know, from the make's own example: with its first
    axis."""
    plain = load_example(make).to_plain()
    first, axis = next(iter(plain["axes"].items()))
    link = dict(plain["link"])
    if link["kind"] == "serial":
        link["device"] = f"/dev/ttyUSB{50 + number}"
    config = {name: plain[name] for name in ("adapter", "options", "simulate") if name in plain}
    return {f"g{number}": {**config, "link": link, "axes": {first: axis}}}


def make_stage_fleet(seed: int, wanted: Sequence[str], stages: Collection[Stage]) -> Fleet:
    """Draw a fleet with at least one controller of each make in `wanted`, and with what jobs of `stages` need. A hall
    has all that its own make needs."""
    if HALL_MAKE in wanted:
        return make_hall_fleet(seed)
    makes_of_stage = PAIR_MAKES if "pair" in stages else _draw_zone_makes(seed, wanted) if "zone" in stages else ()
    has_paths = "chunk" in stages or "flying" in stages
    fleet = make_campaign_fleet(seed, [*wanted, *makes_of_stage], paths=has_paths)
    if "virtual" in stages:
        fleet = add_virtual_axes(fleet, seed)
    if "pair" in stages:
        fleet = add_pair(fleet, PAIR_MAKES)
    if "zone" in stages:
        fleet = add_zones(fleet, makes_of_stage, seed)
    return add_touch_inputs(fleet) if "probe" in stages else fleet


def _draw_zone_makes(seed: int, wanted: Sequence[str]) -> Sequence[str]:
    """Draw the makes of both carriages, one of them in `wanted`, and of the third axis."""
    draw = Random(f"zone makes {seed}")
    body_makes = [wanted[0], draw.choice([make for make in BODY_MAKES if make != wanted[0]])]
    draw.shuffle(body_makes)
    return [*body_makes, draw.choice([make for make in MAKES if make not in body_makes])]


def find_members(fleet: Fleet, make: str) -> list[str]:
    """The controllers of a make that a fault can affect."""
    return [
        name for name, config in fleet.controllers.items() if config.adapter == make and carries_a_body(fleet, name)
    ]


def make_campaign_fleet(seed: int, wanted: Sequence[str], *, paths: bool = False) -> Fleet:
    """Draw a fleet with at least one controller of each make in `wanted`. paths: and with controllers that can execute
    a path together."""
    draw = Random(f"fleet {seed}")
    controllers: FleetDraft = {}
    todo = [*dict.fromkeys(wanted), *([PATH_MAKE, "cia402"] if paths else [])]
    while todo or len(controllers) < LEAST:
        make = todo.pop(0) if todo else draw.choice(MAKES)
        most = min(find_traits(make).most_per_link, MOST - len(controllers) - len(todo))
        units = min(most, draw.choice((2, 2, 3))) if draw.random() < SHARED_LINK_CHANCE else 1
        number = len(controllers)
        drafts = _DRAFTS[make](number, units, draw) if make in _DRAFTS else _draft_other(make, number)
        host = draw.choice(("left", "left", "right"))
        for name, config in drafts.items():
            if paths and make == "cia402":
                config["axes"]["x"]["limits"] = {**_DRIVE_LIMITS, "jerk": PATH_JERK}
            controllers[name] = _complete_config(config, host, draw)
    plain: dict[str, Any] = {"schema": "tutti.fleet/1", "fleet": "campaign", "controllers": controllers}
    gantries = [name for name, config in controllers.items() if PERMIT in config.get("inputs", {})]
    if gantries:
        plain["permits"] = {PERMIT: {"input": f"{gantries[0]}.{PERMIT}", "value": False}}
        ends = [f"{name}.start" for name, config in controllers.items() if "start" in config.get("inputs", {})]
        ends.remove(f"{gantries[0]}.start")
        if ends and draw.random() < 0.5:
            plain["wiring"] = [{"from": f"{gantries[0]}.start", "to": ends, "delay_us": [5, 50]}]
    return Fleet.model_validate(plain)


def _complete_config(config: dict[str, Any], host: str, draw: Random) -> dict[str, Any]:
    crystal = {
        "offset_s": draw.uniform(0, 600),
        "drift_ppm": draw.uniform(-makes.DRIFT_PPM, makes.DRIFT_PPM),
        "wander_ppm": makes.WANDER_PPM,
    }
    axes = {name: {**axis, "soft_limits": _make_soft_limits(axis)} for name, axis in config["axes"].items()}
    simulate = {**config["simulate"], **crystal}
    rates = _PERMIT_POLL_RATES if PERMIT in config.get("inputs", {}) else _POLL_RATES
    return {**config, "axes": axes, "simulate": simulate, "host": host, "state": rates}


def _make_soft_limits(axis: dict[str, Any]) -> dict[str, float]:
    """Return a range for moves of some seconds, which begins a little below zero."""
    velocity = axis["limits"]["velocity"]
    return {"min": -0.1 * velocity, "max": 1.6 * velocity}
