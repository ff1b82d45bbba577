"""Setting commands that do not move anything (section 12.2)."""

import re
from collections.abc import Callable, Sequence

from sim.shrc203.axis import Axis
from sim.shrc203.drive import Kind
from sim.shrc203.grammar import MAX_RAMP_MS, NUMBER, TRIPLE, Refused, division, integer, pulses, speed, split_repeated
from sim.shrc203.origin import preset
from sim.shrc203.path import Triple
from sim.shrc203.trigger import PULSE, SCALE_MINUS, SCALE_PLUS, TIMER, Setting
from sim.shrc203.unit import Area, Unit

_PRESET = re.compile(rf"([+-]?)([NUMDP])({NUMBER})")
_SPEED = re.compile(rf"([FNUMD])({NUMBER})")
_PULSE_TRIGGER = re.compile(r"P([123])P(\d+)")
_SCALE_TRIGGER = re.compile(r"E([123])P([+-])(\d+)")
_CANCELLABLE = frozenset(("S4", "S5", "EMERGENCY"))
"""What BEC: clears (L2452)."""
MODES = ("HOST", "MANUAL", "REMOTE", "TEACHING", "EDIT", "LOAD", "TEST")


def _switch(text: str) -> bool:
    return bool(integer(text, 0, 1))


def set_preset(unit: Unit, text: str) -> None:
    """PSET: (L2229)."""
    axes = unit.group(text[:1] or "?")
    unit.need_ready(axes)
    groups = split_repeated(_PRESET, text[1:], len(axes))
    values = [(sign, pulses(axis, letter, number)) for axis, (sign, letter, number) in _of(axes, groups)]
    for axis, (sign, value) in zip(axes, values, strict=True):
        preset(axis, -value if sign == "-" else value)


def _of(axes: Sequence[Axis], groups: Sequence[re.Match[str]]) -> list[tuple[Axis, tuple[str, ...]]]:
    return [(axis, tuple(match.groups(""))) for axis, match in zip(axes, groups, strict=True)]


def set_sleep(unit: Unit, text: str) -> None:
    """SLEEP: (L2288). On waking, closed loops bring a shifted stage back."""
    asleep = _switch(text)
    unit.need_ready()
    if unit.sleeping and not asleep:
        for axis in unit.controllable:
            if axis.closed_loop:
                axis.slip = 0
    unit.sleeping = asleep


def set_display(unit: Unit, text: str) -> None:
    """BO: (L2315)."""
    lit = _switch(text)
    unit.need_ready()
    unit.display = lit


def set_beep(unit: Unit, text: str) -> None:
    """BEEP: (L2489)."""
    beep = _switch(text)
    unit.need_ready()
    unit.beep = beep


def set_mode(unit: Unit, text: str) -> None:
    """MODE: (L2332), usable in every operation mode."""
    if text not in MODES:
        raise Refused
    unit.need_ready()
    unit.mode = text
    unit.area = Area.HOST if text == "HOST" else Area.PANEL


def set_format(unit: Unit, text: str) -> None:
    """FMT: (L2354). The HIT language is another manual's: of it, only identification and FMT: are known."""
    if text not in ("SHOT_FC", "HIT") or (text == "HIT" and unit.options.hit_refused):
        raise Refused
    unit.need_ready()
    unit.format = text


def set_loop(unit: Unit, text: str) -> None:
    """F:af, 0 closed loop, 1 open loop (L2374). Closed loop needs a scale."""
    axes = unit.group(text[:1] or "?")
    open_loop = _switch(text[1:])
    unit.need_ready(axes)
    if not open_loop and not unit.options.scales:
        raise Refused
    for axis in axes:
        axis.closed_loop = not open_loop
        if axis.closed_loop and axis.stalled_at is None:
            axis.slip = 0


def set_excitation(unit: Unit, text: str) -> None:
    """C:ac, 0 off, 1 on (L2411)."""
    axes = unit.group(text[:1] or "?")
    excited = _switch(text[1:])
    unit.need_ready(axes)
    for axis in axes:
        if excited and not axis.excited:
            axis.hold()
        axis.excited = excited


def cancel_errors(unit: Unit, text: str) -> None:
    """BEC:a releases BUSY and clears limit error, overflow error and emergency stop (L2448)."""
    for axis in unit.group(text):
        axis.errors -= _CANCELLABLE
        axis.check_limits()
        if axis.run is not None:
            unit.drive.give_up(axis.run)


def set_division(unit: Unit, text: str) -> None:
    """S:a,m,… (L2514); invalid with CONFIG on (L2522)."""
    letter, *numbers = text.split(",")
    axes = unit.group(letter or "?")
    unit.need_ready(axes)
    values = [division(number) for number in numbers]
    if len(values) != len(axes) or any(axis.config != "off" for axis in axes):
        raise Refused
    for axis, value in zip(axes, values, strict=True):
        axis.divide = value


def set_wait(unit: Unit, text: str) -> None:
    """W:w, tenths of a second (L2566)."""
    tenths = integer(text, 0, 2550)
    unit.need_ready()
    unit.drive.wait_tenths = tenths


def read_triple(axis: Axis, letter: str, texts: Sequence[str]) -> Triple:
    """S, F and R in a unit; F must not be below S (L3155)."""
    s, f = speed(axis, letter, texts[0]), speed(axis, letter, texts[1])
    if s > f:
        raise Refused
    return Triple(s, f, integer(texts[2], 1, MAX_RAMP_MS))


def _triples(unit: Unit, text: str) -> list[tuple[Axis, Triple]]:
    axes = unit.group(text[:1] or "?")
    unit.need_ready(axes)
    groups = split_repeated(TRIPLE, text[1:], len(axes))
    return [(axis, read_triple(axis, "P", texts)) for axis, texts in _of(axes, groups)]


def set_triple(unit: Unit, text: str) -> None:
    """D: (L4898)."""
    for axis, triple in _triples(unit, text):
        axis.triple = triple


def set_origin_triple(unit: Unit, text: str) -> None:
    """B: (L5207)."""
    for axis, triple in _triples(unit, text):
        axis.origin_triple = triple


def _speeds(unit: Unit, text: str) -> list[tuple[Axis, int]]:
    axes = unit.group(text[:1] or "?")
    groups = split_repeated(_SPEED, text[1:], len(axes))
    return [(axis, speed(axis, letter, number)) for axis, (letter, number) in _of(axes, groups)]


def _change(unit: Unit, text: str, change: Callable[[Triple, int], Triple]) -> None:
    changed = [(axis, change(axis.triple, value)) for axis, value in _speeds(unit, text)]
    unit.need_ready([axis for axis, _ in changed])
    if any(triple.s > triple.f for _, triple in changed):
        raise Refused
    for axis, triple in changed:
        axis.triple = triple


def set_minimum_speed(unit: Unit, text: str) -> None:
    """DS: (L4946)."""
    _change(unit, text, lambda triple, value: Triple(value, triple.f, triple.r))


def set_maximum_speed(unit: Unit, text: str) -> None:
    """DF: (L5015)."""
    _change(unit, text, lambda triple, value: Triple(triple.s, value, triple.r))


def set_ramp(unit: Unit, text: str) -> None:
    """DR:a r,… (L5096)."""
    axes = unit.group(text[:1] or "?")
    unit.need_ready(axes)
    values = [integer(number, 1, MAX_RAMP_MS) for number in text[1:].split(",")]
    if len(values) != len(axes):
        raise Refused
    for axis, value in zip(axes, values, strict=True):
        axis.triple = Triple(axis.triple.s, axis.triple.f, value)


def override_jog(unit: Unit, text: str) -> None:
    """JD: new speed of a running jog, which stays as F afterwards (L5132, decision 41)."""
    speeds = _speeds(unit, text)
    runs = [axis.run for axis, _ in speeds]
    if not all(run is not None and run.kind is Kind.JOG and not run.stopping for run in runs):
        raise Refused
    for (axis, value), run in zip(speeds, runs, strict=True):
        if run is not None:
            axis.triple = Triple(axis.triple.s, value, axis.triple.r)
            unit.drive.change_speed(run, value)


def set_outputs(unit: Unit, text: str) -> None:
    """O:s (L5311), at any time."""
    unit.outputs.set(integer(text, 0, 63))


def set_trigger(unit: Unit, text: str) -> None:
    """T:T, T:P, T:E, T:M, T:S (L5366-L5477)."""
    setting = _read_trigger(unit, text)
    unit.need_ready()
    if text == "M":
        unit.trigger.fire()
    else:
        unit.trigger.set(setting)


def _read_trigger(unit: Unit, text: str) -> Setting | None:
    if text in ("M", "S"):
        return None
    if text[:1] == "T":
        return Setting(TIMER, None, integer(text[1:], 1, 10000))
    match = _PULSE_TRIGGER.fullmatch(text)
    if match is not None:
        return Setting(PULSE, unit.group(match[1])[0], integer(match[2], 2, 30000))
    match = _SCALE_TRIGGER.fullmatch(text)
    if match is None or not unit.options.scales:
        raise Refused
    mode = SCALE_PLUS if match[2] == "+" else SCALE_MINUS
    return Setting(mode, unit.group(match[1])[0], integer(match[3], 2, 30000))
