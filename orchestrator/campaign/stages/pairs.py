"""Pairs of axes that carry one beam, in the fault campaign: such a fleet, and its jobs with both moved as one."""

from collections.abc import Iterable, Sequence
from typing import Any

from orchestrator.campaign.stages.fleet_parts import PAIR_GROUP, find_traits
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of

_MAX_DEVIATION, _MAY_RACK = "3 mm", "60 mm"  # what faults at the campaign's speeds leave room for


def add_pair(fleet: Fleet, makes: Sequence[str]) -> Fleet:
    """The fleet with a beam on the first axes of the first controllers of two makes."""
    plain, carriers = fleet.to_plain(), list[str]()
    for make in makes:
        name = next(name for name, config in fleet.controllers.items() if config.adapter == make)
        config, beam = plain["controllers"][name], find_traits(make).beam
        assert beam is not None
        axis = next(iter(config["axes"]))
        config["options"] = {**config.get("options", {}), **beam.options}
        config["simulate"]["options"] = {**config["simulate"].get("options", {}), **beam.simulate}
        config["axes"][axis]["homing"] = dict(beam.homing)
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
    alone_targets = {axis: target for axis, target in targets.items() if axis not in fleet.virtual_axes.pair_of}
    # They move in phase, and start by clocks.
    fields = {name: value for name, value in step.items() if name not in ("sync", "start")}
    return {**fields, "to": {**alone_targets, **paired_targets}}


def name_pairs(fleet: Fleet, axes: Iterable[str]) -> list[str]:
    """Axes, with the name of their pair for those that are of one."""
    pair_of = fleet.virtual_axes.pair_of
    return list(dict.fromkeys(pair_of[axis].middle if axis in pair_of else axis for axis in axes))
