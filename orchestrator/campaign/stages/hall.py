"""The hall: a fleet of 200 light controllers on four hosts, which has run for long enough to be known."""

from collections.abc import Sequence
from random import Random
from typing import Any

from orchestrator.campaign.recording.recorder import Stage
from orchestrator.clock.base import NS_PER_MS
from orchestrator.coordinator.maintenance.learned import find_learned_digest
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.learned import FLEET, LearnedTimes
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

HALL_MAKE = "light"
"""The make of all its controllers, and of no other fleet of the campaign."""
HALL_LACKS = ("limit", "stall", "permit-lost", "firmware-hung", "link-slow")
"""Faults of what a light controller has not: switches and inputs, a firmware of its own, and a wire."""
HALL_STAGES: tuple[Stage, ...] = ("home", "propose", "arm", "commit", "go", "fire", "motion", "chain")
"""A light controller cannot be jogged."""
HALL_CONTROLLERS, HALL_HOSTS = 200, 4

# Moves as long as those of other fleets, with fewer polls.
_POLL_RATES = {"idle_hz": 0.8, "moving_hz": 3.0}
_HOMING = {"speed": 150}  # a remedy homes fifty one after the other
_SOFT_LIMITS = {"min": -20, "max": 320}
# As a fleet has learned them after some steps: a lead of a tenth of a second, where 200 members have four until then.
_DURATIONS_NS: dict[str, float] = {"release": 30 * NS_PER_MS, "go": 10 * NS_PER_MS, "decision": NS_PER_MS}
_ARM_SHARE = 0.5


def make_hall_fleet(seed: int) -> Fleet:
    """Return a hall, with crystals drawn by `seed`; each controller has one axis, and each host a group."""
    fleet = make_light_fleet(HALL_CONTROLLERS, HALL_HOSTS, Random(f"hall {seed}").getrandbits(32))
    plain: dict[str, Any] = fleet.to_plain()
    for config in plain["controllers"].values():
        config["axes"] = {"x": {**config["axes"]["x"], "soft_limits": _SOFT_LIMITS, "homing": _HOMING}}
        config["state"] = _POLL_RATES
    groups: dict[str, list[str]] = {}
    for name, config in fleet.controllers.items():
        groups.setdefault(f"all-{config.host}", []).append(f"{name}.x")
    return Fleet.model_validate({**plain, "fleet": "campaign", "groups": groups})


def is_hall(fleet: Fleet) -> bool:
    """Whether a fleet of the campaign is a hall."""
    return any(config.adapter == HALL_MAKE for config in fleet.controllers.values())


def name_groups(fleet: Fleet, axes: Sequence[str]) -> list[str]:
    """The axes, with each whole group by its name: they are homed together, and not one after the other."""
    left_axes = dict.fromkeys(axis for name in axes for axis in fleet.expand_name(name))
    names: list[str] = []
    for group, members in fleet.groups.items():
        if left_axes.keys() >= set(members):
            names.append(group)
            for axis in members:
                del left_axes[axis]
    return [*names, *left_axes]


def keep_learned_times(virtual: VirtualFleet) -> None:
    """Put into the journal what a coordinator has learned of a hall. Before the start."""
    fleet, utc = virtual.fleet, virtual.clock.utc()
    virtual.journal.learned.save_times(
        [
            LearnedTimes(
                controller=controller,
                digest=find_learned_digest(fleet, controller),
                utc=utc,
                shares={} if controller == FLEET else {"rest": _ARM_SHARE},
                durations_ns=_DURATIONS_NS if controller == FLEET else {},
            )
            for controller in (FLEET, *fleet.controllers)
        ]
    )
