"""What a forecast knows: where the axes of a job are, step by step, and what is wrong with it."""

from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from fractions import Fraction
from typing import Literal

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.fleet_names import suggest_name
from orchestrator.model.jobs.forecast import AxisForecast, StepProblem
from orchestrator.model.names import controller_of, is_position_name
from orchestrator.model.report import PairBound, PositionBound, RackBound
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.numbers import name_step
from orchestrator.model.units import UnitError, parse_quantity
from orchestrator.plan.flying.path import ChunkAbility
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.ways import ForecastMotion
from orchestrator.plan.probes import ContactRange, ProbeAbilities
from orchestrator.plan.zones.rules import FleetZones

Order = Literal[2, 3]


class ForecastState:
    """Follows axes and outputs; `problems` and `conditions` grow, `axes` is the present state.

    motion: the step that was run forward last, if it is a motion all of whose positions are known. notes: conditions of
    the written step that is run forward. outputs: levels that steps have set. contacts: by the names of later steps,
    where probes may find them; None: not known. ranges: between which motor positions an axis was when its position
    became unknown, where that is known.
    """

    def __init__(
        self,
        fleet: Fleet,
        axes: Mapping[str, AxisForecast] | None = None,
        orders: Mapping[str, Order] | None = None,
        chunks: Mapping[str, ChunkAbility] | None = None,
        probes: Mapping[str, ProbeAbilities] | None = None,
    ) -> None:
        """axes: their states now; others are unknown. orders: of the profiles that each controller executes; chunks:
        how it takes paths in chunks; probes: how it stops axes by inputs."""
        self.fleet = fleet
        self.chunks = chunks or {}
        self.probes = probes or {}
        self.alone: Mapping[str, float | None] = {}
        """For how long controllers go on without their adapters, see `make_fault_reach`."""
        self.orders = orders or {}
        self.axes: dict[str, AxisForecast] = dict(axes or {})
        self.problems: list[StepProblem] = []
        self.conditions: dict[str, None] = {}
        self.notes: dict[str, None] = {}
        self.bounds: dict[str, PositionBound] = {}
        self.followers: dict[str, str] = {}
        self.racks: dict[str, RackBound] = {}
        self.pairs: dict[str, PairBound] = {}
        self.zones = None if fleet.zones is None else FleetZones(fleet)
        self.zones_checked = False
        """Whether the step that is run forward was checked against zones."""
        self.spans_before: dict[str, tuple[float, float] | None] = {}
        """Between which motor positions axes of zones were before it; None: nothing is known of that."""
        self.scan_area: dict[str, tuple[float, float]] = {}
        """Of a scan that is run forward, where its axes are in all of it."""
        self.scanned: dict[str, tuple[float, float]] = {}
        """The same of the axes of scans, while steps at their points are run forward."""
        self.outputs: dict[str, bool] = {}
        self.motion: ForecastMotion | None = None
        self.contacts: dict[str, ContactRange | None] = {}
        self.ranges: dict[str, ContactRange] = {}

    @contextmanager
    def without_zones(self) -> Generator[None]:
        """Check nothing against zones in the context: it runs parts of a step forward that are checked as a whole."""
        zones, self.zones = self.zones, None
        try:
            yield
        finally:
            self.zones = zones

    def order_of(self, name: str, axis: Axis) -> Order:
        return self.orders.get(controller_of(name), 2 if axis.limits.jerk is None else 3)

    def find_state(self, at: ForecastContext, name: str) -> AxisForecast:
        known_axis = self.axes.get(name)
        if known_axis is None:
            # Axes that the job enables by itself need no step for it.
            is_enabled = None if self.fleet.axis(name).enable == "manual" else True
            known_axis = self.axes[name] = AxisForecast(enabled=is_enabled, since=at.index)
        return known_axis

    def require_ready(self, at: ForecastContext, name: str, place: tuple[str | int, ...]) -> None:
        """The axis must be enabled and referenced. place: of the axis in the step."""
        self.require_enabled(at, name, place)
        self.require_referenced(at, name, place, f"axis {name} is not referenced")

    def require_enabled(self, at: ForecastContext, name: str, place: tuple[str | int, ...]) -> None:
        """The axis must be enabled; unless its controller alone knows, it is a problem or it is not."""
        is_enabled = self.find_state(at, name).enabled
        if is_enabled is None:
            self.conditions[f"{name} is enabled before the job"] = None
        elif not is_enabled:
            remedy = "add a step `do: enable` before it"
            self.add_problem(
                at, place, Refusal("not-enabled", f"axis {name} is not enabled", remedy, controller_of(name))
            )
        if not is_enabled:
            self.axes[name] = self.axes[name].model_copy(update={"enabled": True})

    def require_referenced(self, at: ForecastContext, name: str, place: tuple[str | int, ...], text: str) -> None:
        """The axis must be referenced, as `require_enabled`. text: of the problem."""
        is_referenced = self.find_state(at, name).referenced
        if is_referenced is None:
            self.conditions[f"{name} is referenced before the job"] = None
        elif not is_referenced:
            remedy = "add a step `do: home` before it"
            self.add_problem(at, place, Refusal("not-referenced", text, remedy, controller_of(name)))
        if not is_referenced:
            self.axes[name] = self.axes[name].model_copy(update={"referenced": True})

    def find_axis(
        self, at: ForecastContext, name: str, place: tuple[str | int, ...], kind: str = "axis"
    ) -> Axis | None:
        """The real axis of a name; an unknown one is a problem. kind: of the names that the message lists."""
        text = self.fleet.names.explain_unknown(name, kind)
        if text is None:
            return self.fleet.axis(name)
        self.add_problem(at, place, _unknown_name(text))
        return None

    def find_named(self, at: ForecastContext, names: Iterable[str], key: str) -> list[str]:
        """The real axes of names that may be virtual axes; unknown names are problems. key: the field that has them."""
        axes: list[str] = []
        for name in names:
            if name in self.fleet.names.virtual:
                axes += self.fleet.expand_name(name)
            elif self.find_axis(at, name, (key, name), "target") is not None:
                axes.append(name)
        return list(dict.fromkeys(axes))

    def expand_names(self, at: ForecastContext, names: Iterable[str], place: tuple[str | int, ...]) -> list[str]:
        """The axes of all names that exist; the others are problems."""
        axes: list[str] = []
        for number, name in enumerate(names):
            text = self.fleet.names.explain_unknown(name, "axes")
            if text is None:
                axes += self.fleet.expand_name(name)
            else:
                self.add_problem(at, (*place, number), _unknown_name(text))
        return list(dict.fromkeys(axes))

    def parse_amount(self, at: ForecastContext, value: int | float | str, field: TargetField) -> Fraction | None:
        """A target in the unit of its axis; None, and a problem, if it is in another one."""
        try:
            return parse_quantity(value, field.axis.unit)
        except UnitError as error:
            problem = Refusal("bad-unit", f"{field.name}: {error}", "correct the unit", field.controller)
            self.add_problem(at, field.place, problem)
            return None

    def add_problem(self, at: ForecastContext, place: tuple[str | int, ...], problem: Refusal) -> None:
        """Add a problem, each one once. place: of it in the step."""
        found_problem = StepProblem(
            place=[*at.place, *place],
            code=problem.code,
            text=problem.text + at.when,
            remedy=problem.remedy,
            controller=problem.controller,
        )
        if found_problem not in self.problems:
            self.problems.append(found_problem)

    def note_room(self, name: str, state: AxisForecast) -> None:
        """The condition that moves by a distance set on the position where they begin."""
        if state.known or state.lowest == state.highest or name in self.ranges:
            return
        axis = self.fleet.axis(name)
        if axis.soft_limits is None:
            return
        low, high = axis.soft_limits.in_unit(axis.unit)
        begin, end = float(low - state.lowest), float(high - state.highest)
        self.conditions[
            f"{name} stands between {begin:g} and {end:g} {axis.unit} (motor position) before {name_step(state.since)}"
        ] = None

    def check_name(self, at: ForecastContext, name: str, kind: Literal["output", "input"]) -> bool:
        """Whether the fleet has this output or input; otherwise it is a problem of the field `kind`."""
        text = self.fleet.names.explain_unknown(name, kind)
        if text is not None:
            self.add_problem(at, (kind,), _unknown_name(text))
        return text is None

    def lose_positions(self, at: ForecastContext, axes: Iterable[str]) -> None:
        for axis in axes:
            state_before = self.find_state(at, axis)
            # It was counted from a position that does not hold any more.
            kind = "unknown" if state_before.offset_kind == "start" else state_before.offset_kind
            self.axes[axis] = state_before.model_copy(update={**unknown_position(at), "offset_kind": kind})
            self.ranges.pop(axis, None)

    def find_range(self, name: str) -> ContactRange | None:
        """Between which motor positions an axis stands now; None: it is not known."""
        state, begin = self.axes[name], self.ranges.get(name)
        if state.known:
            return ContactRange(state.motor, state.motor)
        return None if begin is None else ContactRange(begin.low + state.motor, begin.high + state.motor)

    def note_unknown_positions(self, step: Step) -> list[str]:
        """Note the positions that only the running fleet knows; return the axes that the step moves there."""
        axes: dict[str, None] = {}
        for axis, target in step.iterate_targets():
            if is_position_name(target):
                axes[axis] = None
                hint = suggest_name(str(target), self.fleet.names.positions).strip()
                condition = f"position {target} is saved in the running fleet"
                self.conditions[f"{condition} ({hint})" if hint else condition] = None
        return list(axes)


def _unknown_name(text: str) -> Refusal:
    return Refusal("unknown-name", text, "correct the name")


def unknown_position(at: ForecastContext) -> dict[str, object]:
    """The fields of an axis whose position is not known from this step on."""
    nowhere = Fraction(0)
    return {
        "motor": nowhere,
        "known": False,
        "since": at.index + 1,
        "lowest": nowhere,
        "highest": nowhere,
        "play": None,
    }
