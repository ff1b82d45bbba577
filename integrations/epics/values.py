"""The values of a motor record: how they follow readings and each other."""

from collections.abc import Callable
from typing import Protocol

from integrations.epics.fields import FIELDS, GO, Value
from integrations.epics.readings import Alarm, AxisReading, find_alarm, find_msta
from tutti import AxisInfo

Done = Callable[[str | None], None]
"""Ends a put, with the text of what went wrong."""
Post = Callable[[Value, float | None], None]
"""Publishes a value. The time stamp is UTC in s; None: now."""
MOST_STEPS = 2**31 - 1  # RVAL is LONG in motorRecord.dbd
JOG_MARGIN_S = 1.0  # a jog keeps the way of this time from a soft limit: LVIO in motorRecord.html


class Record(Protocol):
    """What a protocol serves: values by name, with an alarm that they have in common."""

    values: dict[str, Value]
    alarm: Alarm

    def follow(self, name: str, post: Post) -> Callable[[], None]: ...
    def put(self, name: str, raw: object, done: Done) -> None: ...


class Published:
    """Values by name, each published when it changes, all of them when their alarm changes."""

    def __init__(self, values: dict[str, Value]) -> None:
        self.values = values
        self.alarm = Alarm()
        self._posts: dict[str, list[Post]] = {name: [] for name in values}

    def follow(self, name: str, post: Post) -> Callable[[], None]:
        """Publish a value by `post` from now on, until what is returned is called."""
        self._posts[name].append(post)
        return lambda: self._posts[name].remove(post)

    def _set(self, name: str, value: Value, stamp_s: float | None = None) -> None:
        if self.values[name] != value:
            self.values[name] = value
            self._post(name, stamp_s)

    def _set_alarm(self, alarm: Alarm, stamp_s: float | None) -> None:
        if alarm != self.alarm:
            self.alarm = alarm
            for name in self.values:
                self._post(name, stamp_s)

    def _post(self, name: str, stamp_s: float | None) -> None:
        for post in tuple(self._posts[name]):
            post(self.values[name], stamp_s)


class MotorValues(Published):
    """Values of the record of the axis `axis`, by the names of its fields. reading: the last one."""

    def __init__(self, info: AxisInfo, first: AxisReading, velocity: float) -> None:
        self.axis = info.name
        self._problem = ""
        self.reading = first
        self._fleet_limits: tuple[float, float] | None = None
        if info.least is not None and info.most is not None:
            self._fleet_limits = (info.least - first.offset, info.most - first.offset)
        low, high = self._fleet_limits or (0.0, 0.0)
        step = info.resolution
        values: dict[str, Value] = {
            **{name: field.zero for name, field in FIELDS.items()},
            **{"EGU": info.unit, "OUT": f"tutti {info.name}", "DESC": info.description or info.name},
            **{"MRES": step, "ERES": step, "RDBD": step, "SREV": 200, "UREV": 200 * step, "PREC": info.digits},
            # ACCL is of the whole ramp: at a lower VELO it is shorter, and a run-up by ACCL long enough.
            **{"VMAX": info.velocity, "VELO": velocity, "ACCL": info.velocity / info.acceleration, "TWV": 100 * step},
            **{"DLLM": low, "DHLM": high, "SPMG": GO, "DMOV": 1, "RBV": first.position},
        }
        super().__init__(values)

    def _take(self, reading: AxisReading) -> None:
        self.reading, stamp, limit = reading, reading.utc_s, reading.limit
        is_forward = reading.position >= self._number("RBV")
        for name, value in {
            "RBV": reading.position,
            "DRBV": reading.position - reading.offset,
            "OFF": reading.offset,
            "MOVN": int(reading.moving),
            "HLS": int(limit in ("forward", "both")),
            "LLS": int(limit in ("reverse", "both")),
            "CNEN": int(reading.enabled),
            "MSTA": find_msta(reading, is_forward=is_forward),
        }.items():
            self._set(name, value, stamp)
        self._set_user_limits(stamp)
        self._update_alarm()

    def _number(self, name: str) -> float:
        return float(self.values[name])

    @property
    def _jog_direction(self) -> int:
        return int(self.values["JOGF"]) - int(self.values["JOGR"])

    def _set_target(self, target: float) -> None:
        dial = target - self._number("OFF")
        steps = min(max(round(dial / self._number("MRES")), -MOST_STEPS), MOST_STEPS)
        for name, value in {"VAL": target, "DVAL": dial, "RVAL": steps}.items():
            self._set(name, value)

    def _sync(self) -> None:
        self._set_target(self._number("RBV"))

    def _set_user_limits(self, stamp_s: float | None = None) -> None:
        offset = self._number("OFF") if self._fleet_limits else 0.0
        self._set("LLM", self._number("DLLM") + offset, stamp_s)
        self._set("HLM", self._number("DHLM") + offset, stamp_s)

    def _update_alarm(self) -> None:
        alarm = find_alarm(self.reading, self._problem)
        self.values.update(SEVR=alarm.severity, STAT=alarm.status)
        self._set_alarm(alarm, self.reading.utc_s)

    def _is_outside(self, target: float) -> bool:
        margin = self._number("MRES") / 1000
        low, high = self._number("LLM") - margin, self._number("HLM") + margin
        return self._fleet_limits is not None and not low <= target <= high

    def _is_near_limit(self, direction: int) -> bool:
        return self._is_outside(self._number("RBV") + direction * JOG_MARGIN_S * self._number("VELO"))
