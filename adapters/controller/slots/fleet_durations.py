"""Durations of a step, between fleet time and the clock of this computer.

Profiles and triggers arrive in fleet time, and a make lowers them to the clock of its host. On the coordinator's own
computer the two are the same. Elsewhere a crystal that is 50 ppm off would put an axis 1 ms off after 20 s; so
durations are converted, in and out, and only what the estimate of that rate may be off is left as an error. All
requests are checked before that, in fleet time: limits are not exceeded by a slow clock.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from adapters.contract import Lowered
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.fleet import FleetScale
from orchestrator.model.messages import BudgetTerm, OutputTrigger, StartOptions
from orchestrator.model.profile import Profile


@dataclass(frozen=True, slots=True)
class StatedMove:
    """What a lowered move is in fleet time. tick_ns, terms, edge, triggers, clock_ppm: as in `Lowered`."""

    durations_s: dict[str, float]
    tick_ns: float
    terms: list[BudgetTerm]
    edge: list[BudgetTerm]
    triggers: dict[str, list[BudgetTerm]]
    clock_ppm: float


def to_host_profiles(profiles: dict[str, Profile], scale: FleetScale) -> dict[str, Profile]:
    """The profiles, as long by the clock of this computer as they are in fleet time."""
    if not scale.rate:
        return profiles
    return {axis: profile.stretch_time(scale.host_share) for axis, profile in profiles.items()}


def to_host_start(start: StartOptions, scale: FleetScale) -> StartOptions:
    """The start options with the instants of triggers and the end of a chunk by the clock of this computer."""
    if not scale.rate or not (start.triggers or start.chunk):
        return start
    chunk = start.chunk
    if chunk is not None:
        chunk = chunk.model_copy(update={"end_s": chunk.end_s * scale.host_share})
    triggers = [_to_host_trigger(trigger, scale) for trigger in start.triggers]
    return start.model_copy(update={"triggers": triggers, "chunk": chunk})


def _to_host_trigger(trigger: OutputTrigger, scale: FleetScale) -> OutputTrigger:
    return trigger.model_copy(
        update={"instants_ns": [round(instant_ns * scale.host_share) for instant_ns in trigger.instants_ns]}
    )


def state_move(lowered: Lowered, scale: FleetScale, t0_host_ns: int, triggers: Mapping[str, int]) -> StatedMove:
    """What a lowered move is in fleet time. triggers: by output with triggers, the last of its instants, ns after T0.

    The uncertainty of fleet time is a term of its own in every window, except in that of a member that waits for a
    trigger line: its start is where the edge is, whatever its host believes about the time.
    """
    terms, edge = list(lowered.terms), list(lowered.edge)
    switch_terms = {output: list(terms) for output, terms in lowered.triggers.items()}
    if not scale.is_exact:
        own = make_fleet_time_term(scale, t0_host_ns)
        if lowered.start_class != "line":
            terms.append(own)
        if edge:
            edge.append(own)
        for output, output_terms in switch_terms.items():
            output_terms.append(make_fleet_time_term(scale, t0_host_ns + triggers[output]))
    return StatedMove(
        durations_s={axis: duration_s * (1.0 + scale.rate) for axis, duration_s in lowered.durations_s.items()},
        tick_ns=lowered.tick_ns * (1.0 + scale.rate),
        terms=terms,
        edge=edge,
        triggers=switch_terms,
        clock_ppm=lowered.clock_ppm + scale.drift_ppm,
    )


def make_fleet_time_term(scale: FleetScale, host_ns: int) -> BudgetTerm:
    """What fleet time may be off at an instant."""
    bound_ns = scale.bound_at_ns(host_ns)
    return BudgetTerm(name="fleet-time", earliest_ns=-bound_ns, latest_ns=bound_ns)


def find_last_instants(start: StartOptions) -> dict[str, int]:
    """By output with triggers, the last of its instants, ns after T0; of a path in chunks the end of the first one,
    which may have none."""
    end_ns = 0 if start.chunk is None else round(start.chunk.end_s * NS_PER_S)
    return {trigger.output: max([end_ns, *trigger.instants_ns[-1:]]) for trigger in start.triggers}
