"""Pairs of axes that carry one beam, in the fault campaign: such a fleet, and its jobs with both moved as one."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from orchestrator.campaign.fleet_parts import PAIR_GROUP
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of

PAIR_MAKES = ("smc4000", "cia402")
"""The makes of both axes: each has a watchdog, and finds an index in a direction of its own."""
_MAX_DEVIATION, _MAY_RACK = "3 mm", "60 mm"  # what faults at the campaign's speeds leave room for
_SEARCH_SPEED = 0.5  # mm/s, of both
_INDEX_COUNTS = 20
_OPTIONS: Mapping[str, tuple[dict[str, Any], str, dict[str, Any]]] = {
    "smc4000": ({"watchdog_s": 0.5}, "index", {"index_every": {"X": _INDEX_COUNTS, "Y": _INDEX_COUNTS}}),
    "cia402": ({"watchdog_ms": 500}, "index_negative", {"index_every": _INDEX_COUNTS}),
}
"""By make: options of the controller, the homing method, and options of the simulator."""
PAIR_HOMING = tuple(method for _, method, _ in _OPTIONS.values())


def add_pair(fleet: Fleet) -> Fleet:
    """The fleet with a beam on the first axes of the first controllers of both makes."""
    plain, carriers = fleet.to_plain(), list[str]()
    for make in PAIR_MAKES:
        name = next(name for name, config in fleet.controllers.items() if config.adapter == make)
        config, (options, method, simulate) = plain["controllers"][name], _OPTIONS[make]
        axis = next(iter(config["axes"]))
        config["options"] = {**config.get("options", {}), **options}
        config["simulate"]["options"] = {**config["simulate"].get("options", {}), **simulate}
        config["axes"][axis]["homing"] = {"method": method, "speed": _SEARCH_SPEED, "search_speed": _SEARCH_SPEED}
        carriers.append(f"{name}.{axis}")
    pair = {"max_deviation": _MAX_DEVIATION, "may_rack": _MAY_RACK}
    plain["virtual"] = {PAIR_GROUP: {"of": carriers, "pair": pair, "axes": {"y": {"unit": "mm"}}}}
    return Fleet.model_validate(plain)


def find_paired_controllers(fleet: Fleet) -> list[str]:
    """The controllers of all pairs of a fleet, each once."""
    pairs = fleet.virtual_axes.pairs.values()
    return list(dict.fromkeys(controller_of(axis) for pair in pairs for axis in pair.real))


def move_pairs_as_one(fleet: Fleet, steps: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Steps of axes as steps in which the axes of a pair are named by the pair."""
    return [_move_pair(fleet, step) for step in steps] if fleet.virtual_axes.pairs else list(steps)


def _move_pair(fleet: Fleet, step: dict[str, Any]) -> dict[str, Any]:
    if step["do"] == "home":
        return {**step, "axes": name_pairs(fleet, fleet.expand_names(step["axes"]))}
    targets = step.get("to", {})
    paired_targets = {
        pair.middle: min(targets[axis] for axis in pair.real if axis in targets)
        for pair in fleet.virtual_axes.pairs.values()
        if set(pair.real) & set(targets)
    }
    if not paired_targets:
        return step
    alone = {axis: target for axis, target in targets.items() if axis not in fleet.virtual_axes.pair_of}
    # They move in phase, and start by clocks.
    others = {name: value for name, value in step.items() if name not in ("sync", "start")}
    return {**others, "to": {**alone, **paired_targets}}


def name_pairs(fleet: Fleet, axes: Iterable[str]) -> list[str]:
    """Axes, with the name of their pair for those that are of one."""
    pair_of = fleet.virtual_axes.pair_of
    return list(dict.fromkeys(pair_of[axis].middle if axis in pair_of else axis for axis in axes))
