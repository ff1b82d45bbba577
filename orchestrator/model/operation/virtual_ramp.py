"""Jogs of virtual axes: the velocities of their real axes, changed by one common ramp."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from orchestrator.model.errors import Refusal
from orchestrator.model.names import split_name
from orchestrator.model.operation.virtual_jog import STEP_S, VirtualJog
from orchestrator.model.operation.virtual_state import VirtualState

FIRST_SHARE = 0.1
"""Of a step, the first one from rest: controllers take longer to begin a jog than to change it."""
AGE_S = 0.4
"""From a state, which is as old as a poll, until the step that follows from it is taken."""
SLOWEST_SHARE = 0.02
"""Of the wanted speed: at less than that a virtual axis is at its end."""
TOLERANCE = 1e-9


@dataclass(slots=True)
class VirtualRamp:
    """The velocities of virtual axes on the way to those that are wanted, unit/s, by name.

    states: of their groups, as they come. is_settled: the last step has reached the wanted velocities, or what is left
    of them shortly before a soft limit. Each step changes all velocities by the same share of their way, so that no
    real axis is asked for more than its acceleration. Velocities whose real axes move in other directions are reached
    through rest, all axes together.
    """

    states: dict[str, VirtualState]
    wanted: dict[str, float] = field(default_factory=dict[str, float])
    present: dict[str, float] = field(default_factory=dict[str, float])
    is_settled: bool = True
    _varied: dict[str, float] = field(default_factory=dict[str, float])  # sum of all changes since rest
    _gone: dict[str, float] = field(default_factory=dict[str, float])  # since rest
    _moving_s: float = 0.0

    @property
    def is_moving(self) -> bool:
        """Whether a velocity has been sent that is not 0."""
        return any(self.present.values())

    @property
    def groups(self) -> list[str]:
        """The groups of the virtual axes."""
        return list(dict.fromkeys(split_name(axis)[0] for axis in self.wanted))

    def request(self, velocities: Mapping[str, float]) -> None:
        """Want velocities from now on. Raises `Refusal`: codes `no-jog`, `too-fast`, `soft-limit`."""
        goal = {**self.wanted, **velocities}
        load, text = 0.0, ""
        for axis, velocity in goal.items():
            if velocity:
                jog = self._require_jog(axis)
                load += abs(velocity) / jog.speed if jog.speed else math.inf
                text = self._describe_speed(axis, jog, velocity)
        if load > 1 + TOLERANCE:
            *company, _ = (axis for axis, velocity in goal.items() if velocity)
            company_text = f", together with {', '.join(company)}" if company else ""
            raise Refusal("too-fast", f"axis {text}{company_text}", "jog more slowly")
        for axis, velocity in velocities.items():
            self._require_way(axis, velocity)
        self.wanted = goal

    def require_jogging(self) -> None:
        """Refuse to renew what has been stopped."""
        if not any(self.wanted.values()):
            raise Refusal("not-jogging", "the virtual axes were stopped", "press the jog key again")

    def request_rest(self) -> None:
        """Want all axes to come to rest."""
        self.wanted = dict.fromkeys(self.wanted, 0.0)

    def clear(self) -> None:
        """Forget all: the real axes were stopped."""
        self.wanted, self.present, self._varied, self._gone, self._moving_s = {}, {}, {}, {}, 0.0

    def step(self, elapsed_s: float) -> dict[str, float]:
        """The velocities of the real axes for the next `elapsed_s` at most, unit/s, by `controller.axis`; 0 for all of
        them: they stop. Raises `Refusal`: code `soft-limit` when a virtual axis has come to its end, and `deviation`
        when another one of its group might be off its position by more than it should."""
        goal, is_last = self._limit_to_ends(self.wanted), True
        if self.is_moving and _find_signs(self.find_real(goal)) != _find_signs(self.find_real(self.present)):
            goal, is_last = dict.fromkeys(goal, 0.0), not any(goal.values())
        needed_s = sum(
            abs(velocity - self.present.get(axis, 0.0)) / self._require_jog(axis).acceleration
            for axis, velocity in goal.items()
            if velocity != self.present.get(axis, 0.0)
        )
        begin_velocities = self.present
        for axis, velocity in begin_velocities.items():
            self._gone[axis] = self._gone.get(axis, 0.0) + velocity * elapsed_s
        self._moving_s = self._moving_s + elapsed_s if self.is_moving else 0.0
        share = self._find_share(needed_s, elapsed_s) if self._is_ramped(goal) else 1.0
        self.is_settled = is_last and share == 1.0
        self.present = {
            axis: _move_towards(begin_velocities.get(axis, 0.0), velocity, share) for axis, velocity in goal.items()
        }
        for axis, velocity in self.present.items():
            self._varied[axis] = self._varied.get(axis, 0.0) + abs(velocity - begin_velocities.get(axis, 0.0))
        if not self.is_moving:
            self._varied, self._gone = {}, {}
        elif any(self.wanted.values()):
            self._require_deviations()
        return self.find_real(self.present)

    def _find_share(self, needed_s: float, elapsed_s: float) -> float:
        """The share of its way that a step makes, where all of it needs `needed_s`."""
        if not self.is_moving:
            return min(1.0, FIRST_SHARE * STEP_S / needed_s) if needed_s else 1.0
        step_s = min(elapsed_s, STEP_S)
        if needed_s <= step_s * (1 + TOLERANCE):
            return 1.0
        # Steps of one size: what is left for the last one must not be below the lowest speed of a controller.
        return 1.0 / math.ceil(needed_s / step_s * (1 - TOLERANCE)) if step_s > 0 else 0.0

    def find_real(self, velocities: Mapping[str, float]) -> dict[str, float]:
        """The velocities of the real axes at those of virtual ones; real axes that these do not move are left out."""
        reals: dict[str, float] = {}
        for axis, velocity in velocities.items():
            jog = self._require_jog(axis)
            for name, rate in zip(self._state_of(axis).of, jog.rates, strict=True):
                if rate:
                    reals[name] = reals.get(name, 0.0) + rate * velocity
        return reals

    def _state_of(self, axis: str) -> VirtualState:
        return self.states[split_name(axis)[0]]

    def _require_jog(self, axis: str) -> VirtualJog:
        state = self._state_of(axis)
        name = split_name(axis)[1]
        jog = state.jogs.get(name)
        if jog is not None:
            return jog
        if state.axes and name not in state.axes:
            raise Refusal("unknown-axis", f"{state.group} has the axes {', '.join(state.axes)}", "see `tutti status`")
        if state.axes and state.pair is None:
            text = (
                f"axis {axis} cannot be jogged: its group is curved, and a jog of {', '.join(state.of)} would leave it"
            )
            raise Refusal("no-jog", text, "jog the real axes")
        raise Refusal("no-jog", f"axis {axis} cannot be jogged: {state.obstacle}", "see `tutti status`")

    def _describe_speed(self, axis: str, jog: VirtualJog, velocity: float) -> str:
        state = self._state_of(axis)
        name = split_name(axis)[1]
        unit = state.axes[name].unit
        uncorrected_text = "by its own real axis alone, uncorrected" if jog.lacks_tables else ""
        offs = " and ".join(
            f"{split_name(axis)[0]}.{other_name} is off by at most {off + jog.play.get(other_name, 0.0):.3g} "
            f"{state.axes[other_name].unit}"
            for other_name, off in jog.off.items()
        )
        off_text = f", {uncorrected_text}, where {offs}" if uncorrected_text else f", where {offs}" if offs else ""
        return f"{axis} may jog at {jog.speed:.4g} {unit}/s at most{off_text}, not at {abs(velocity):g}"

    def _require_way(self, axis: str, velocity: float) -> None:
        """Refuse a velocity towards a soft limit that is reached."""
        if not velocity:
            return
        jog = self._require_jog(axis)
        way, end = self._find_way(axis, jog, velocity)
        if way is None or self._find_limited_speed(jog, way) >= SLOWEST_SHARE * abs(velocity):
            return
        if not end:
            raise Refusal("jog-reach", f"axis {axis} has gone as far as one jog of it goes", "jog again")
        raise Refusal("soft-limit", f"axis {axis} is at the soft limit of {end}", "jog in the other direction")

    def _find_way(self, axis: str, jog: VirtualJog, velocity: float) -> tuple[float | None, str]:
        """How far an axis may go on, and what is at its soft limit there; empty: the reach of the jog ends there."""
        way, end = (jog.high, jog.high_by) if velocity > 0 else (jog.low, jog.low_by)
        way = None if way is None else abs(way)
        if jog.reach is None:
            return way, end
        gone_way = math.copysign(1.0, velocity) * self._gone.get(axis, 0.0)
        way_left = max(jog.reach - gone_way, 0.0)
        return (way, end) if way is not None and way < way_left else (way_left, "")

    def _require_deviations(self) -> None:
        """Refuse to go on where another axis might be off its position by more than its `jog.deviation`, also once all
        have stopped."""
        offs: dict[str, float] = {}
        for axis, velocity in self.present.items():
            group, jog = split_name(axis)[0], self._require_jog(axis)
            rises = (self._varied[axis] + abs(velocity)) / 2
            until_rest_s = self._moving_s + abs(velocity) / jog.acceleration + STEP_S
            for name, limit in jog.deviations.items():
                off = jog.off[name] * rises / jog.speed if rises else 0.0
                off += jog.drift[name] * until_rest_s + jog.play.get(name, 0.0) if rises else 0.0
                offs[f"{group}.{name}"] = offs.get(f"{group}.{name}", 0.0) + off
                if offs[f"{group}.{name}"] > limit * (1 + TOLERANCE):
                    unit = self._state_of(axis).axes[name].unit
                    text = f"axis {group}.{name} might be off its position by {limit:g} {unit} if this jog went on"
                    raise Refusal(
                        "deviation", text, "jog again; hold a jog for less long, and change its speed less often"
                    )

    def _limit_to_ends(self, velocities: Mapping[str, float]) -> dict[str, float]:
        """Velocities from which all axes can be at rest at the first soft limit. Raises `Refusal` at it."""
        load = 0.0
        for axis, velocity in velocities.items():
            if not velocity:
                continue
            self._require_way(axis, velocity)
            jog = self._require_jog(axis)
            way, _ = self._find_way(axis, jog, velocity)
            if way is not None:
                load += abs(velocity) / self._find_limited_speed(jog, way)
        return {axis: velocity / max(1.0, load) for axis, velocity in velocities.items()}

    def _find_limited_speed(self, jog: VirtualJog, way: float) -> float:
        """The speed from which an axis is at rest within a way: way = v age + v² / (2 acceleration)."""
        return jog.acceleration * (math.hypot(AGE_S, math.sqrt(2 * way / jog.acceleration)) - AGE_S)

    def _is_ramped(self, axes: Collection[str]) -> bool:
        """Whether one of them moves several real axes, which need a common ramp."""
        return any(self._require_jog(axis).is_common for axis in axes)


def _move_towards(begin: float, end: float, share: float) -> float:
    """A share of the way from one velocity to another; exactly the other one at its end."""
    return end if share == 1.0 else begin + share * (end - begin)


def _find_signs(velocities: Mapping[str, float]) -> dict[str, bool]:
    """Whether each axis that moves does so in its positive direction."""
    return {axis: velocity > 0 for axis, velocity in velocities.items() if velocity}
