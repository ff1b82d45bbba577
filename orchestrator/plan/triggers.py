"""Triggers of a motion step in counts, and the instants at which its plan reaches them.

Positions are crossings of the planned profile, whichever way the axis goes: an axis of a path that comes back crosses
them again. The start is none of them, and the end is one, if it is a position asked for.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.numbers import format_ns
from orchestrator.model.profile import Profile
from orchestrator.model.steps.triggers import Trigger
from orchestrator.model.units import UnitError, parse_quantity
from orchestrator.plan.step import StepPlan

Array = NDArray[np.float64]

MAX_INSTANTS = 20_000  # of one trigger that is loaded as a whole
MAX_CHUNKED_INSTANTS = 200_000  # of one that is loaded with the chunks of a path
NEAR_COUNTS = 1.0  # a position this close behind the end of the way is the end: targets are rounded to counts
HALVINGS = 60  # of the span in which a crossing is

FindOffset = Callable[[str], Fraction]
"""User minus motor position of an axis, in its unit."""


@dataclass(frozen=True, slots=True)
class ResolvedTrigger:
    """A trigger in counts. place: in the step. axis: None: it is one in time.

    times_ns, period_ns: from the start. positions: absolute counts, with their text. step_counts: between positions,
    from the start of the axis on, 0 without. places_s: of a flight, instants of its plan instead of positions.
    """

    place: int
    output: str
    pulse_ns: int
    axis: str | None = None
    times_ns: tuple[int, ...] = ()
    period_ns: int = 0
    positions: tuple[tuple[float, str], ...] = ()
    step_counts: float = 0.0
    places_s: tuple[float, ...] = ()

    @property
    def owner(self) -> str:
        """The controller of the output."""
        return controller_of(self.output)

    def find_instants_ns(self, plan: StepPlan, most: int = MAX_INSTANTS) -> list[int]:
        """The instants from T0 on, growing. Raises `Refusal` for positions that the plan does not reach, and if there
        are none, or more than `most`."""
        if self.places_s:
            instants = [round(place_s * NS_PER_S) for place_s in self.places_s]
        elif self.axis is None:
            instants = self._find_times_ns(round(plan.duration_s * NS_PER_S), most)
        else:
            profile = plan.profiles.get(self.axis)
            if profile is None:
                raise self._refuse("trigger-axis", f"axis {self.axis} does not move", "name an axis that moves")
            levels = self._find_levels(profile, most)
            crossings = find_crossings(profile, np.array(sorted(set(levels))))
            instants = sorted({round(crossing_s * NS_PER_S) for crossing_s in crossings.tolist()})
        if not instants:
            raise self._refuse("trigger-never", "the step is over before the first one", "write a shorter `every`")
        if len(instants) > most:
            raise self._too_many(len(instants), most)
        return instants

    def _find_times_ns(self, duration_ns: int, most: int) -> list[int]:
        if not self.period_ns:
            late = next((instant_ns for instant_ns in self.times_ns if instant_ns > duration_ns), None)
            if late is not None:
                text = f"{format_ns(late)} is after the end of the step, which lasts {format_ns(duration_ns)}"
                raise self._refuse("trigger-late", text, "remove it, or move slower")
            return list(self.times_ns)
        count = duration_ns // self.period_ns
        if count > most:
            raise self._too_many(count, most)
        return [number * self.period_ns for number in range(1, count + 1)]

    def _find_levels(self, profile: Profile, most: int) -> list[float]:
        """The positions relative to the start of the axis, counts."""
        places = _find_nodes(profile)[:, 1]
        low, high = float(places.min()), float(places.max())
        if self.step_counts:
            first = ceil((low - NEAR_COUNTS / 2) / self.step_counts)
            last = floor((high + NEAR_COUNTS / 2) / self.step_counts)
            if last - first > most:
                raise self._too_many(last - first, most)
            return [min(max(number * self.step_counts, low), high) for number in range(first, last + 1)]
        levels: list[float] = []
        for counts, text in self.positions:
            level = counts - profile.start_counts
            if not low - NEAR_COUNTS <= level <= high + NEAR_COUNTS or abs(level) < NEAR_COUNTS / 2:
                raise self._refuse(
                    "trigger-position",
                    f"{text} is not on the way of axis {self.axis} in this step, its start excluded",
                    "remove it from `at`, or change the way",
                )
            levels.append(min(max(level, low), high))
        return levels

    def _too_many(self, count: int, most: int) -> Refusal:
        text = f"has {count} instants; the most of a step are {most}"
        return self._refuse("trigger-count", text, "write a longer `every`, or divide the step")

    def _refuse(self, code: str, text: str, remedy: str) -> Refusal:
        return Refusal(code, f"`triggers.{self.place}` of output {self.output}: {text}", remedy, self.owner)


def resolve_triggers(fleet: Fleet, triggers: Sequence[Trigger], find_offset: FindOffset) -> list[ResolvedTrigger]:
    """The triggers of a step in counts. Raises `Refusal` for an output that is unknown or in use, and for units."""
    used_outputs = find_used_outputs(fleet) if triggers else {}
    resolved_triggers: list[ResolvedTrigger] = []
    for number, trigger in enumerate(triggers):
        explanation = fleet.names.explain_unknown(trigger.output, "output")
        if explanation is not None:
            raise Refusal("unknown-name", f"`triggers.{number}`: {explanation}", "correct the name")
        if trigger.output in used_outputs:
            raise Refusal(
                "output-in-use",
                f"`triggers.{number}`: output {trigger.output} is {used_outputs[trigger.output]}",
                "use another output, or remove that use from the fleet file",
                controller_of(trigger.output),
            )
        resolved_triggers.append(_resolve_trigger(fleet, number, trigger, find_offset))
    return resolved_triggers


def _resolve_trigger(fleet: Fleet, place: int, trigger: Trigger, find_offset: FindOffset) -> ResolvedTrigger:
    plain = ResolvedTrigger(place, trigger.output, trigger.pulse_ns, trigger.of)
    if trigger.of is None:
        if trigger.every is not None:
            return replace(plain, period_ns=trigger.period_ns)
        return replace(plain, times_ns=tuple(trigger.instants_ns))
    if trigger.of in fleet.names.virtual:
        text = f"`triggers.{place}`: {trigger.of} is a virtual axis, and triggers count positions of real ones"
        raise Refusal("virtual-axis", text, "give instants (`every: 20 ms`), or name a real axis", plain.owner)
    axis = fleet.axis(trigger.of)
    if axis.is_compensated:
        text = f"`triggers.{place}`: {trigger.of} has `backlash` or `correction`, which do not count on the way yet"
        raise Refusal("not-compensated", text, "give instants (`every: 20 ms`)", plain.owner)
    try:
        if trigger.every is not None:
            step = abs(float(parse_quantity(trigger.every, axis.unit) * axis.counts_per_unit))
            return replace(plain, step_counts=step)
        offset = find_offset(trigger.of)
        positions = tuple((_to_counts(axis, position, offset), f"{position}") for position in trigger.at or [])
    except UnitError as error:
        raise Refusal("bad-unit", f"`triggers.{place}`: {error}", "correct the unit", plain.owner) from None
    return replace(plain, positions=positions)


def _to_counts(axis: Axis, value: int | float | str, offset: Fraction) -> float:
    return float((parse_quantity(value, axis.unit) - offset) * axis.counts_per_unit)


def find_brake_outputs(fleet: Fleet) -> dict[str, str]:
    """Outputs of holding brakes, with what they are."""
    reserved_outputs: dict[str, str] = {}
    for controller, config in fleet.controllers.items():
        for name, axis in config.axes.items():
            if axis.brake is not None and axis.brake.output is not None:
                reserved_outputs[f"{controller}.{axis.brake.output}"] = f"the brake of {controller}.{name}"
    return reserved_outputs


def find_used_outputs(fleet: Fleet) -> dict[str, str]:
    """Outputs that the fleet file uses for something else than triggers, with what they are."""
    permits = {permit.input: name for name, permit in fleet.permits.items()}
    used_outputs = find_brake_outputs(fleet)
    for wire in fleet.wiring:
        named_permit = next((permits[end] for end in wire.to if end in permits), None)
        ends = ", ".join(wire.to)
        used_outputs[wire.from_] = f"wired to {ends}" + (
            f", for the permit {named_permit}" if named_permit else ", as a trigger line"
        )
    return used_outputs


def group_by_owner(triggers: Sequence[ResolvedTrigger]) -> Mapping[str, list[ResolvedTrigger]]:
    """The triggers by the controller of their outputs."""
    groups: dict[str, list[ResolvedTrigger]] = {}
    for trigger in triggers:
        groups.setdefault(trigger.owner, []).append(trigger)
    return groups


# Crossings


def find_crossings(profile: Profile, levels: Array) -> Array:
    """When a profile passes positions, s from its start, growing. levels: relative to the start, counts, sorted.

    A level at the start is passed only if the axis comes back to it; one at a turning point once.
    """
    nodes = _find_nodes(profile)
    begins, ends = nodes[:-1], nodes[1:]
    rising = ends[:, 1] > begins[:, 1]
    lows, highs = np.minimum(begins[:, 1], ends[:, 1]), np.maximum(begins[:, 1], ends[:, 1])
    # The end of a piece belongs to it, its start to the piece before.
    firsts = np.where(rising, np.searchsorted(levels, lows, "right"), np.searchsorted(levels, lows, "left"))
    lasts = np.where(rising, np.searchsorted(levels, highs, "right"), np.searchsorted(levels, highs, "left"))
    counts = np.maximum(lasts - firsts, 0)
    piece = np.repeat(np.arange(len(counts)), counts)
    order = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    wanted_level = levels[firsts[piece] + order]
    instants = _halve(profile, begins[piece], ends[piece], wanted_level)
    sequence = np.argsort(instants, kind="stable")
    return _drop_wavering(profile, instants[sequence], wanted_level[sequence])


def _drop_wavering(profile: Profile, instants: Array, levels: Array) -> Array:
    """The crossings without those of a level from which the axis has not moved away by a count since: a profile that
    was fitted to a path wavers by fractions of one where it begins, turns or ends."""
    find_range, kept_instants = make_range_finder(profile), list[float]()
    last_s, last_level = 0.0, 0.0
    for at_s, level in zip(instants.tolist(), levels.tolist(), strict=True):
        if level == last_level:
            low, high = (counts - profile.start_counts - level for counts in find_range(last_s, at_s))
            if max(-low, high) < NEAR_COUNTS:
                continue
        kept_instants.append(at_s)
        last_s, last_level = at_s, level
    return np.array(kept_instants)


def _find_nodes(profile: Profile) -> Array:
    """Ends of spans in which the profile goes one way: rows of time, position, number of the segment that begins or
    contains the span after it."""
    rows: list[tuple[float, float, float]] = []
    for number, segment in enumerate(profile.segments):
        rows.append((segment.start_s, segment.position, number))
        for turn in sorted(_find_turns(segment.velocity, segment.acceleration, segment.jerk)):
            if 0.0 < turn < segment.duration_s:
                rows.append((segment.start_s + turn, segment.state_at(turn).position, number))
    rows.append((profile.duration_s, float(profile.end_counts - profile.start_counts), len(profile.segments) - 1))
    return np.array(rows)


def _find_turns(velocity: float, acceleration: float, jerk: float) -> list[float]:
    """When v + a t + j t²/2 is zero."""
    if jerk == 0.0:
        return [-velocity / acceleration] if acceleration else []
    square = acceleration * acceleration - 2 * jerk * velocity
    if square < 0.0:
        return []
    return [(-acceleration - square**0.5) / jerk, (-acceleration + square**0.5) / jerk]


def _halve(profile: Profile, before: Array, after: Array, wanted: Array) -> Array:
    """The instants in the spans from `before` to `after` at which the profile is at `wanted`."""
    table = np.array([tuple(segment) for segment in profile.segments])
    start, _, position, velocity, acceleration, jerk = table[before[:, 2].astype(int)].T
    low, high = before[:, 0].copy(), after[:, 0].copy()
    rising = after[:, 1] > before[:, 1]
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        t = middle - start
        position_here = position + t * (velocity + t * (acceleration / 2 + t * jerk / 6))
        is_reached = (position_here >= wanted) == rising
        high, low = np.where(is_reached, middle, high), np.where(is_reached, low, middle)
    return high


def make_range_finder(profile: Profile) -> Callable[[float, float], tuple[float, float]]:
    """A function of two instants, s from the start: the least and the greatest absolute position between them,
    counts."""
    nodes, at = _find_nodes(profile), profile.make_evaluator()
    times, places = nodes[:, 0].tolist(), nodes[:, 1].tolist()

    def find_range(early_s: float, late_s: float) -> tuple[float, float]:
        places_inside = places[bisect_left(times, early_s) : bisect_right(times, late_s)]
        points = [at(early_s).position, at(late_s).position, *places_inside]
        return profile.start_counts + min(points), profile.start_counts + max(points)

    return find_range
