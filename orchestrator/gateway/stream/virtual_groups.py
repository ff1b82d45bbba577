"""What the stream shows of virtual axes: each group like a controller, with its axes."""

import contextlib
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from orchestrator.gateway.stream.controllers import DIGITS, find_age_s
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.virtual_axes import VirtualGroup

MAX_GROUPS = 200  # whatever is published


class VirtualGroups:
    """The newest states of the groups. They are parsed when they are shown."""

    def __init__(self) -> None:
        self._raw: dict[str, bytes] = {}
        self._states: dict[str, VirtualState] = {}
        self._received_ns: dict[str, int] = {}

    def take_payload(self, group: str, payload: bytes, now_ns: int) -> None:
        """Store the state of a group as it was published."""
        if group in self._received_ns or len(self._received_ns) < MAX_GROUPS:
            self._raw[group] = payload
            self._received_ns[group] = now_ns

    def find_rest(self, group: str, axis: str) -> float | None:
        """The commanded position of a virtual axis that is at rest; None if it is not known."""
        state = self._read_state(group)
        if state is None or state.moving or axis not in state.axes:
            return None
        return state.axes[axis].target

    def compose(self, fleet: Fleet | None, targets: Mapping[str, float], now_ns: int) -> dict[str, Any]:
        """The groups of the fleet file as a part of the stream; without any no part. targets: of the running steps, by
        `group.axis`."""
        shown_groups: dict[str, Any] = {}
        for name, group in ({} if fleet is None else fleet.virtual).items():
            state = self._read_state(name)
            if state is None:
                continue
            age = {"age_s": find_age_s(now_ns - self._received_ns[name])}
            shown_groups[name] = show_group(state, group, targets) | age
        return {"virtual": shown_groups} if shown_groups else {}

    def _read_state(self, group: str) -> VirtualState | None:
        raw = self._raw.pop(group, None)
        if raw is not None:
            with contextlib.suppress(ValidationError):
                self._states[group] = VirtualState.read_message(raw)
        return self._states.get(group)


def show_group(state: VirtualState, group: VirtualGroup, targets: Mapping[str, float]) -> dict[str, Any]:
    """The group for the stream, with the fields of a controller as far as it has them."""
    has_map = bool(state.axes)
    mode = ("moving" if state.moving else "idle") if has_map else "offline"
    return {
        "present": True,
        "mode": mode,
        "make": f"{group.kind} of {', '.join(state.of)}",
        "of": state.of,
        "faults": [] if has_map else [{"code": "virtual", "text": state.obstacle, "remedy": state.obstacle}],
        "axes": {name: _show_axis(name, state, group, targets) for name in group.axes},
    }


def _show_axis(name: str, state: VirtualState, group: VirtualGroup, targets: Mapping[str, float]) -> dict[str, Any]:
    config, axis, jog = group.axes[name], state.axes.get(name), state.jogs.get(name)
    shown_axis: dict[str, Any] = {
        "unit": config.unit.value,
        "moving": state.moving,
        "enabled": state.enabled,
        "referenced": state.referenced,
        "jog_velocity": 0 if jog is None else round(jog.speed, DIGITS),
    }
    if axis is not None:
        shown_axis |= {
            "position": round(axis.position, DIGITS),
            "commanded": round(axis.target, DIGITS),
            "velocity": round(axis.velocity, DIGITS),
        }
    if state.obstacle and state.enabled and state.referenced:
        shown_axis["fault"] = state.obstacle
    target = targets.get(f"{state.group}.{name}")
    if target is not None:
        shown_axis["target"] = round(target, DIGITS)
    if config.soft_limits is not None:
        low, high = config.soft_limits.in_unit(config.unit)
        shown_axis |= {"min": round(float(low), DIGITS), "max": round(float(high), DIGITS)}
    return shown_axis
