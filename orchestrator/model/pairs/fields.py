"""What is wrong with the fields of an axis of two motors in a fleet file."""

from collections.abc import Mapping
from typing import Any

from orchestrator.model.pairs.rack import MotorRack


def explain_pair_field(name: str, value: float | None, data: Mapping[str, Any]) -> str | None:
    """Why the field `name` cannot have a value; None if it can. data: the valid fields before it."""
    count = len(data.get("motors", ()))
    if count == 1 and value:
        return f"{name} applies between the motors of one axis, but this axis has one motor"
    if count != 2:
        return None
    if name == "max_deviation":
        return _explain_deviation(value, data)
    if data.get("max_deviation") is None:
        return None
    return _explain_rack(value, data) if name == "may_rack" else _explain_square(value or 0.0, data)


def _explain_deviation(deviation: float | None, data: Mapping[str, Any]) -> str | None:
    if deviation is None:
        return "an axis of two motors needs max_deviation, how far they may be apart"
    if data.get("kind") == "rotary" or data.get("start_rate") is not None:
        return "an axis of two motors is linear (no `kind: rotary`), without `start_rate`"
    return None


def _explain_rack(length: float | None, data: Mapping[str, Any]) -> str | None:
    if not {"limits", "homing", "following_error"} <= data.keys():
        return None
    rack, ramp, speed = (
        MotorRack.of(data["max_deviation"], data["following_error"], length),
        data["limits"].acceleration,
        data["homing"].speed,
    )
    if rack.most <= rack.watched:
        return (
            f"may_rack ({rack.most:g}) must be above max_deviation and following_error together ({rack.watched:g}): "
            "the motors may be that far apart before anything stops"
        )
    if speed is not None and speed > rack.fastest(ramp):
        return (
            f"homing.speed ({speed:g}) is too fast for may_rack ({rack.most:g}): after a fault the motors may be "
            f"{rack.at_speed(speed, ramp):.4g} apart; at most {rack.fastest(ramp):.4g} fits"
        )
    return None


def _explain_square(offset: float, data: Mapping[str, Any]) -> str | None:
    if abs(offset) <= data["max_deviation"]:
        return None
    return (
        f"square ({offset:g}) is beyond max_deviation ({data['max_deviation']:g}): the beam would be skewed by that at "
        "the reference of the second motor; move its switch"
    )
