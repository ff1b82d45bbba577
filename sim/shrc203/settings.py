"""Setting commands that do not move anything (section 12.2)."""

import re
from collections.abc import Callable, Sequence

from sim.shrc203.axis import RunKind, StageAxis
from sim.shrc203.grammar import (
    MAX_RAMP_MS,
    NUMBER,
    TRIPLE,
    CommandRefused,
    parse_division,
    parse_integer,
    parse_pulses,
    parse_speed,
    split_repeated,
)
from sim.shrc203.origin import preset_coordinate
from sim.shrc203.path import SpeedTriple
from sim.shrc203.trigger import PULSE, SCALE_MINUS, SCALE_PLUS, TIMER, TriggerSetting
from sim.shrc203.unit import CommandArea, StageSystem

_PRESET = re.compile(rf"([+-]?)([NUMDP])({NUMBER})")
_SPEED = re.compile(rf"([FNUMD])({NUMBER})")
_PULSE_TRIGGER = re.compile(r"P([123])P(\d+)")
_SCALE_TRIGGER = re.compile(r"E([123])P([+-])(\d+)")
_CANCELLABLE = frozenset(("S4", "S5", "EMERGENCY"))
"""Errors that BEC: clears (L2452)."""
MODES = ("HOST", "MANUAL", "REMOTE", "TEACHING", "EDIT", "LOAD", "TEST")


def _parse_switch(text: str) -> bool:
    return bool(parse_integer(text, 0, 1))


def set_preset(unit: StageSystem, text: str) -> None:
    """PSET: (L2229)."""
    axes = unit.resolve_axes(text[:1] or "?")
    unit.require_ready(axes)
    groups = split_repeated(_PRESET, text[1:], len(axes))
    values = [
        (sign, parse_pulses(axis, letter, number)) for axis, (sign, letter, number) in _axes_with_values(axes, groups)
    ]
    for axis, (sign, value) in zip(axes, values, strict=True):
        preset_coordinate(axis, -value if sign == "-" else value)


def _axes_with_values(
    axes: Sequence[StageAxis], groups: Sequence[re.Match[str]]
) -> list[tuple[StageAxis, tuple[str, ...]]]:
    return [(axis, tuple(match.groups(""))) for axis, match in zip(axes, groups, strict=True)]


def set_sleep(unit: StageSystem, text: str) -> None:
    """SLEEP: (L2288). On waking, closed loops return a shifted stage."""
    asleep = _parse_switch(text)
    unit.require_ready()
    if unit.sleeping and not asleep:
        for axis in unit.controllable:
            if axis.closed_loop:
                axis.scale_deviation = 0
    unit.sleeping = asleep


def set_display(unit: StageSystem, text: str) -> None:
    """BO: (L2315)."""
    lit = _parse_switch(text)
    unit.require_ready()
    unit.display = lit


def set_beep(unit: StageSystem, text: str) -> None:
    """BEEP: (L2489)."""
    beep = _parse_switch(text)
    unit.require_ready()
    unit.beep = beep


def set_mode(unit: StageSystem, text: str) -> None:
    """MODE: (L2332), usable in every operation mode."""
    if text not in MODES:
        raise CommandRefused
    unit.require_ready()
    unit.mode = text
    unit.area = CommandArea.HOST if text == "HOST" else CommandArea.PANEL


def set_format(unit: StageSystem, text: str) -> None:
    """FMT: (L2354). The HIT language has a manual of its own: only its identification and FMT: are implemented."""
    if text not in ("SHOT_FC", "HIT") or (text == "HIT" and unit.options.hit_refused):
        raise CommandRefused
    unit.require_ready()
    unit.format = text


def set_loop(unit: StageSystem, text: str) -> None:
    """F:af, 0 closed loop, 1 open loop (L2374). Closed loop needs a scale."""
    axes = unit.resolve_axes(text[:1] or "?")
    open_loop = _parse_switch(text[1:])
    unit.require_ready(axes)
    if not open_loop and not unit.options.scales:
        raise CommandRefused
    for axis in axes:
        axis.closed_loop = not open_loop
        if axis.closed_loop and axis.stalled_at is None:
            axis.scale_deviation = 0


def set_excitation(unit: StageSystem, text: str) -> None:
    """C:ac, 0 off, 1 on (L2411)."""
    axes = unit.resolve_axes(text[:1] or "?")
    is_on = _parse_switch(text[1:])
    unit.require_ready(axes)
    for axis in axes:
        if is_on and not axis.excited:
            axis.restore_torque()
        axis.excited = is_on


def cancel_errors(unit: StageSystem, text: str) -> None:
    """BEC:a releases BUSY and clears limit error, overflow error and emergency stop (L2448)."""
    for axis in unit.resolve_axes(text):
        axis.errors -= _CANCELLABLE
        axis.check_limits()
        if axis.run is not None:
            unit.drive.stop_settling(axis.run)


def set_division(unit: StageSystem, text: str) -> None:
    """S:a,m,… (L2514); invalid with CONFIG on (L2522)."""
    letter, *numbers = text.split(",")
    axes = unit.resolve_axes(letter or "?")
    unit.require_ready(axes)
    values = [parse_division(number) for number in numbers]
    if len(values) != len(axes) or any(axis.config != "off" for axis in axes):
        raise CommandRefused
    for axis, value in zip(axes, values, strict=True):
        axis.divide = value


def set_wait(unit: StageSystem, text: str) -> None:
    """W:w, tenths of a second (L2566)."""
    tenths = parse_integer(text, 0, 2550)
    unit.require_ready()
    unit.drive.wait_tenths = tenths


def read_triple(axis: StageAxis, letter: str, texts: Sequence[str]) -> SpeedTriple:
    """Parse S, F and R in a unit; F must not be below S (L3155)."""
    s, f = parse_speed(axis, letter, texts[0]), parse_speed(axis, letter, texts[1])
    if s > f:
        raise CommandRefused
    return SpeedTriple(s, f, parse_integer(texts[2], 1, MAX_RAMP_MS))


def _parse_triples(unit: StageSystem, text: str) -> list[tuple[StageAxis, SpeedTriple]]:
    axes = unit.resolve_axes(text[:1] or "?")
    unit.require_ready(axes)
    groups = split_repeated(TRIPLE, text[1:], len(axes))
    return [(axis, read_triple(axis, "P", texts)) for axis, texts in _axes_with_values(axes, groups)]


def set_triple(unit: StageSystem, text: str) -> None:
    """D: (L4898)."""
    for axis, triple in _parse_triples(unit, text):
        axis.triple = triple


def set_origin_triple(unit: StageSystem, text: str) -> None:
    """B: (L5207)."""
    for axis, triple in _parse_triples(unit, text):
        axis.origin_triple = triple


def _parse_speeds(unit: StageSystem, text: str) -> list[tuple[StageAxis, int]]:
    axes = unit.resolve_axes(text[:1] or "?")
    groups = split_repeated(_SPEED, text[1:], len(axes))
    return [(axis, parse_speed(axis, letter, number)) for axis, (letter, number) in _axes_with_values(axes, groups)]


def _change_triples(unit: StageSystem, text: str, change: Callable[[SpeedTriple, int], SpeedTriple]) -> None:
    new_triples = [(axis, change(axis.triple, value)) for axis, value in _parse_speeds(unit, text)]
    unit.require_ready([axis for axis, _ in new_triples])
    if any(triple.s > triple.f for _, triple in new_triples):
        raise CommandRefused
    for axis, triple in new_triples:
        axis.triple = triple


def set_minimum_speed(unit: StageSystem, text: str) -> None:
    """DS: (L4946)."""
    _change_triples(unit, text, lambda triple, value: SpeedTriple(value, triple.f, triple.r))


def set_maximum_speed(unit: StageSystem, text: str) -> None:
    """DF: (L5015)."""
    _change_triples(unit, text, lambda triple, value: SpeedTriple(triple.s, value, triple.r))


def set_ramp(unit: StageSystem, text: str) -> None:
    """DR:a r,… (L5096)."""
    axes = unit.resolve_axes(text[:1] or "?")
    unit.require_ready(axes)
    values = [parse_integer(number, 1, MAX_RAMP_MS) for number in text[1:].split(",")]
    if len(values) != len(axes):
        raise CommandRefused
    for axis, value in zip(axes, values, strict=True):
        axis.triple = SpeedTriple(axis.triple.s, axis.triple.f, value)


def override_jog(unit: StageSystem, text: str) -> None:
    """JD: new speed of a running jog, which stays as F afterwards (L5132, decision 41)."""
    speeds = _parse_speeds(unit, text)
    runs = [axis.run for axis, _ in speeds]
    if not all(run is not None and run.kind is RunKind.JOG and not run.stopping for run in runs):
        raise CommandRefused
    for (axis, value), run in zip(speeds, runs, strict=True):
        if run is not None:
            axis.triple = SpeedTriple(axis.triple.s, value, axis.triple.r)
            unit.drive.change_speed(run, value)


def set_outputs(unit: StageSystem, text: str) -> None:
    """O:s (L5311), at any time."""
    unit.outputs.set_levels(parse_integer(text, 0, 63))


def set_trigger(unit: StageSystem, text: str) -> None:
    """T:T, T:P, T:E, T:M, T:S (L5366-L5477)."""
    setting = _read_trigger(unit, text)
    unit.require_ready()
    if text == "M":
        unit.trigger.fire_pulse()
    else:
        unit.trigger.set_trigger(setting)


def _read_trigger(unit: StageSystem, text: str) -> TriggerSetting | None:
    if text in ("M", "S"):
        return None
    if text[:1] == "T":
        return TriggerSetting(TIMER, None, parse_integer(text[1:], 1, 10000))
    match = _PULSE_TRIGGER.fullmatch(text)
    if match is not None:
        return TriggerSetting(PULSE, unit.resolve_axes(match[1])[0], parse_integer(match[2], 2, 30000))
    match = _SCALE_TRIGGER.fullmatch(text)
    if match is None or not unit.options.scales:
        raise CommandRefused
    mode = SCALE_PLUS if match[2] == "+" else SCALE_MINUS
    return TriggerSetting(mode, unit.resolve_axes(match[1])[0], parse_integer(match[3], 2, 30000))
