"""The language of a described controller."""

from collections.abc import Callable, Sequence
from math import sqrt
from typing import Literal

from adapters.ascii.description import Description, QueryText, SettingText, StepText, packaged_names
from adapters.ascii.patterns import LinePattern
from adapters.contract import ControllerIdentity
from adapters.toolkit.lines.dialect import (
    LineAxisStatus,
    LineMeaning,
    LineSetting,
    LineState,
    LineStatus,
    LineStep,
    LineTarget,
    LineTraits,
)
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Axis, Controller

_Limit = Literal["none", "forward", "reverse", "both"]
_LIMITS: dict[tuple[bool, bool], _Limit] = {
    (True, True): "both",
    (True, False): "forward",
    (False, True): "reverse",
    (False, False): "none",
}


class DescribedDialect:
    """A `LineDialect` from a description, for the axes of a controller."""

    def __init__(self, description: Description, config: Controller) -> None:
        self._text = description
        self._config = config
        self._status = LinePattern(description.status.match)
        self._session = LinePattern(description.session.match)
        self._identity = LinePattern(description.identity.match)
        self._refused = LinePattern(description.refused)
        self._restarted = None if description.restarted is None else LinePattern(description.restarted)
        self._ignored = None if description.ignored is None else LinePattern(description.ignored)

    @property
    def traits(self) -> LineTraits:
        text = self._text
        return LineTraits(
            joint=text.joint,
            fixed_acceleration=text.fixed_acceleration,
            armed_state=text.armed_state,
            answers_while_homing=text.answers_while_homing,
            keeps_session=text.keeps_session,
            switches_motors=bool(text.enable),
            terminators=tuple(text.reply_ends),
            session_place=text.find_place("session"),
        )

    @property
    def spoiler(self) -> bytes:
        return _encode(self._text.spoiler)

    @property
    def stop_bytes(self) -> bytes:
        return _encode(self._text.stop)

    @property
    def stop_search_bytes(self) -> bytes:
        return _encode(self._text.stop if self._text.stop_search is None else self._text.stop_search)

    def classify_line(self, line: str) -> LineMeaning:
        if self._restarted is not None and self._restarted.matches(line):
            return "restarted"
        return "ignored" if self._ignored is not None and self._ignored.matches(line) else "reply"

    def find_refusal(self, line: str) -> str:
        refusal_match = self._refused.match(line)
        return "" if refusal_match is None else f"{line} ({self._text.name})"

    # Queries

    def ask_identity(self) -> LineStep:
        return self._make_query(self._text.identity, "identity")

    def read_identity(self, lines: Sequence[str]) -> ControllerIdentity | None:
        groups: dict[str, str] = {}
        for line in lines:
            groups |= self._identity.match(line) or {}
        if "other" in groups:
            text = f"it is {groups['other']}, and not {self._text.name} ({self._text.find_place('identity', 'match')})"
            names = ", ".join(packaged_names())
            raise ControllerFault("config-mismatch", text, f"`options: {{description: …}}`; with Tutti come {names}")
        model = groups.get("model", self._text.identity.model)
        if not groups or not model:
            return None
        return ControllerIdentity(model, groups.get("firmware", ""), groups.get("serial", ""))

    def ask_status(self) -> LineStep:
        return self._make_query(self._text.status, "status")

    def read_status(self, lines: Sequence[str]) -> LineStatus | None:
        groups = self._status.match(lines[-1])
        if groups is None:
            return None
        text = self._text.status
        try:
            positions = [float(number_text) for number_text in groups["positions"].split(",")]
            flags = [int(number_text) for number_text in groups["flags"].split(",")] if "flags" in groups else []
            free = int(groups["free"]) if text.free_when_empty and "free" in groups else None
        except (ValueError, KeyError):
            return None
        motors = self._text.motors
        if len(positions) < len(motors) or (not text.states and len(flags) < len(motors)):
            return None
        state = self._read_state(groups.get("state", ""), flags)
        if state is None:
            return None
        axes: dict[str, LineAxisStatus] = {}
        for number, motor in enumerate(motors):
            bits = flags[number] if flags else 0
            is_moving = bool(bits & text.moving_bit) if flags else state == "moving"
            limit = _LIMITS[bool(bits & text.forward_bit), bool(bits & text.reverse_bit)]
            axes[motor] = LineAxisStatus(positions[number], is_moving, limit)
        is_loaded = None
        if free is not None:
            is_loaded = free < text.free_when_empty
        elif text.armed_bit:
            is_loaded = any(flag & text.armed_bit for flag in flags)
        alarm = groups.get("state", "") if state == "alarm" else ""
        return LineStatus(state, axes, is_loaded, alarm, self._find_doubt(state, free))

    def _read_state(self, word: str, flags: Sequence[int]) -> LineState | None:
        """What a status means, by its word, or by the bits of all motors; None for an unknown word."""
        text = self._text.status
        if not text.states:
            return "moving" if any(flag & text.moving_bit for flag in flags) else "idle"
        return text.states.get(word) or text.states.get(word.partition(":")[0])

    def _find_doubt(self, state: LineState, free: int | None) -> str:
        """What a status at rest shows that the description does not expect."""
        expected_free = self._text.status.free_when_empty
        if state not in ("idle", "alarm") or free is None or free == expected_free:
            return ""
        source = self._text.find_place("status", "free_when_empty")
        return f"its receive buffer has {free} free bytes at rest, not {expected_free} ({source})"

    def ask_session(self) -> LineStep:
        return self._make_query(self._text.session, "session")

    def read_session(self, lines: Sequence[str]) -> int | None:
        for line in lines:
            groups = self._session.match(line)
            if groups is not None:
                return int(groups["number"]) if groups["number"].isdecimal() else None
        return None

    def write_session(self, number: int) -> Sequence[LineStep]:
        text = self._text.session
        step = StepText(send=text.write.format(number=number), last=text.written)
        return [self._make_step(step, "session", "written")]

    def settings(self) -> Sequence[LineSetting]:
        settings: list[LineSetting] = []
        for text in self._text.settings:
            step = self._make_step(StepText(send=text.send, last=text.last), "settings")
            if "{index}" not in text.match and text.bit != "motor":
                bit = text.bit if isinstance(text.bit, int) else None
                settings.append(_make_setting(text, step, "", _make_reader(text.match, bit), float(text.value)))
                continue
            for name, axis in self._config.axes.items():
                index = self._text.motors.index(axis.motors[0])
                reader = _make_reader(
                    text.match.replace("{index}", str(index)), index if text.bit == "motor" else text.bit
                )
                settings.append(_make_setting(text, step, f" of axis {name}", reader, _setting_value(text, axis)))
        return settings

    # Motion

    def load_move(self, targets: Sequence[LineTarget]) -> Sequence[LineStep]:
        text = self._text
        targets_text = text.separator.join(text.target.format(**self._values(target)) for target in targets)
        distance = sqrt(sum(target.distance**2 for target in targets))
        longest = max(targets, key=lambda target: abs(target.distance))
        path = longest.velocity * distance / abs(longest.distance)
        values = {"targets": targets_text, "path_velocity": f"{path * text.velocity_factor:.6f}"}
        return self._make_steps(text.load, "load", **values)

    def start_move(self) -> LineStep:
        return self._make_step(self._text.start, "start")

    def finish_stop(self) -> Sequence[LineStep]:
        return self._make_steps(self._text.finish_stop, "finish_stop")

    def search_reference(self, motors: Sequence[str], timeout_s: float) -> Sequence[LineStep]:
        steps: list[LineStep] = []
        for number, text in enumerate(self._text.home):
            timed_text, field = text.model_copy(update={"timeout_s": timeout_s}), ("home", number)
            if "{motor}" in text.send or "{number}" in text.send:
                steps += [
                    self._make_step(timed_text, *field, motor=motor, number=self._number(motor), motors="")
                    for motor in motors
                ]
            else:
                steps.append(self._make_step(timed_text, *field, motors="".join(motors)))
        return steps

    def begin_jog(self, target: LineTarget) -> Sequence[LineStep]:
        return self._make_steps(self._text.jog, "jog", **self._values(target))

    def stop_jog(self, motor: str) -> bytes:
        return _encode(self._text.jog_stop.format(motor=motor, number=self._number(motor)))

    def switch_motors(self, motors: Sequence[str], *, on: bool) -> Sequence[LineStep]:
        return self._make_steps(self._text.enable, "enable") if on else ()

    def clear_alarm(self) -> Sequence[LineStep]:
        return self._make_steps(self._text.clear_alarm, "clear_alarm")

    def _make_query(self, text: QueryText, *field: str | int) -> LineStep:
        return self._make_step(StepText(send=text.send, last=text.last), *field, "last")

    def _make_steps(self, texts: Sequence[StepText], name: str, **values: str) -> list[LineStep]:
        return [self._make_step(text, name, number, **values) for number, text in enumerate(texts)]

    def _make_step(self, text: StepText, *field: str | int, **values: str) -> LineStep:
        """A step that is written in the description as `field`."""
        command = text.send.format(**values) if values else text.send
        last = None if text.last is None else LinePattern(text.last)
        return LineStep(
            _encode(command),
            None if last is None else last.matches,
            tuple(text.until),
            text.timeout_s,
            "" if text.last is None else f"a line like {text.last!r} ({self._text.find_place(*field)})",
        )

    def _number(self, motor: str) -> str:
        return str(self._text.motors.index(motor) + 1)

    def _values(self, target: LineTarget) -> dict[str, str]:
        text = self._text
        return {
            "motor": target.motor,
            "number": self._number(target.motor),
            "position": f"{target.position:.{text.decimals}f}",
            "velocity": f"{target.velocity * text.velocity_factor:.6f}",
            "acceleration": f"{target.acceleration:.6f}",
        }


def _setting_value(text: SettingText, axis: Axis) -> float:
    match text.value:
        case "scale":
            return float(axis.scale)
        case "acceleration":
            return axis.limits.acceleration
        case "velocity_per_minute":
            return axis.limits.velocity * 60
        case "searches_backwards":
            return float(axis.homing_sign < 0)
        case _:
            return float(text.value)


def _make_reader(match: str, bit: int | None) -> Callable[[str], float | None]:
    """What finds the value of a setting in a line; of a bit, 0 or 1."""
    pattern = LinePattern(match)

    def read(line: str) -> float | None:
        groups = pattern.match(line)
        try:
            if groups is None:
                return None
            return float(groups["value"]) if bit is None else float(int(groups["value"]) >> bit & 1)
        except (ValueError, KeyError):
            return None

    return read


def _make_setting(
    text: SettingText, step: LineStep, where: str, read: Callable[[str], float | None], expected: float
) -> LineSetting:
    return LineSetting(
        item=text.item + where,
        step=step,
        read=read,
        expected=expected,
        remedy=text.remedy,
        is_minimum=text.is_minimum,
    )


def _encode(text: str) -> bytes:
    return text.encode("latin-1")
