"""Commands that set, start and stop motion (section 12.3)."""

import re
from collections.abc import Sequence
from fractions import Fraction

from sim.shrc203.axis import EndCause, PathRun, Ready, RunKind, RunOrder, StageAxis
from sim.shrc203.entries import ArcMove, Entry, InputStandby, JogMove, LinearMove, TimedStandby, TravelMove
from sim.shrc203.geometry import CollinearPoints, find_circumcentre
from sim.shrc203.grammar import NUMBER, TRIPLE, CommandRefused, parse_integer, parse_pulses, split_repeated
from sim.shrc203.launch import start_travel
from sim.shrc203.line import Reply
from sim.shrc203.origin import METHODS, find_origin, go_to_zero, set_zero, undo_zero
from sim.shrc203.path import SpeedTriple
from sim.shrc203.settings import read_triple
from sim.shrc203.unit import StageSystem

_AMOUNT = re.compile(rf"([+-])([PNUMD])({NUMBER})")
_LINE_AMOUNT = re.compile(rf"([+-]?)([PNUM])({NUMBER})")
_LINE_AMOUNT_PRE = re.compile(rf"([+-]?)([PNUMD])({NUMBER})")
_ARC_AMOUNT = re.compile(rf"([+-]?)([PNUM])({NUMBER})|([+-])({NUMBER})")
_ARC = re.compile(r"([0-5])([ABC])([01])(?:N(\d+))?(.*)")
_ANGLE = re.compile(rf"D({NUMBER})")
_METHOD = re.compile(r"(?:H|HRT)([0-4])?")
_DEGREES = {1: 360, 4: 360_000}
_VALUES = {0: 2, 1: 2, 2: 4, 3: 2, 4: 2, 5: 4}
_MOST_ROTATIONS = 1000


def _apply_sign(sign: str, value: int) -> int:
    return -value if sign == "-" else value


def _split_speeds(text: str, *, pre: bool) -> tuple[str, str | None]:
    """A prebuffer command may carry speeds after a comma."""
    body, comma, speeds = text.partition(",")
    if comma and not (pre and speeds):
        raise CommandRefused
    return body, speeds if comma else None


def _write_buffers(unit: StageSystem, axes: Sequence[StageAxis], entries: Sequence[Entry], *, pre: bool) -> str:
    """Write the buffers; reply OK, or OK_D for the prebuffer of a running operation (L235)."""
    if not pre:
        for entry in entries:
            unit.chain.set_execution(entry)
        return "OK"
    is_deferred = unit.chain.is_deferred(axes)
    for entry in entries:
        unit.chain.set_pre(entry)
    return "OK_D" if is_deferred else "OK"


def _set_travel(unit: StageSystem, text: str, *, absolute: bool, pre: bool) -> str:
    body, speeds = _split_speeds(text, pre=pre)
    axes = unit.resolve_axes(body[:1] or "?")
    if not pre:
        unit.require_ready(axes)
    unit.require_error_free(axes)
    groups = [match.groups() for match in split_repeated(_AMOUNT, body[1:], len(axes))]
    triples: list[SpeedTriple | None] = [None] * len(axes)
    if speeds is not None:
        speed_groups = split_repeated(TRIPLE, speeds, len(axes))
        pairs = zip(axes, groups, speed_groups, strict=True)
        triples = [read_triple(axis, letter, match.groups()) for axis, (_, letter, _), match in pairs]
    entries = [
        TravelMove(axis, absolute, _apply_sign(sign, parse_pulses(axis, letter, number)), triple, pre)
        for axis, (sign, letter, number), triple in zip(axes, groups, triples, strict=True)
    ]
    return _write_buffers(unit, axes, entries, pre=pre)


def set_relative(unit: StageSystem, text: str, reply: Reply) -> str:
    """M: (L3009)."""
    del reply
    return _set_travel(unit, text, absolute=False, pre=False)


def set_relative_pre(unit: StageSystem, text: str, reply: Reply) -> str:
    """MP: (L3092)."""
    del reply
    return _set_travel(unit, text, absolute=False, pre=True)


def set_absolute(unit: StageSystem, text: str, reply: Reply) -> str:
    """A: (L3171)."""
    del reply
    return _set_travel(unit, text, absolute=True, pre=False)


def set_absolute_pre(unit: StageSystem, text: str, reply: Reply) -> str:
    """AP: (L3249)."""
    del reply
    return _set_travel(unit, text, absolute=True, pre=True)


def _check_interpolation(unit: StageSystem, axes: Sequence[StageAxis], *, pre: bool) -> None:
    if not pre:
        unit.require_ready(axes)
    unit.require_error_free(axes)
    unit.require_no_limit(axes)


def _first_triple(axis: StageAxis, letter: str, speeds: str | None) -> SpeedTriple | None:
    """Parse the one triple of EP and KP, in the unit of the smallest-numbered axis (L3980)."""
    if speeds is None:
        return None
    return read_triple(axis, letter, split_repeated(TRIPLE, speeds, 1)[0].groups())


def _set_line(unit: StageSystem, text: str, *, pre: bool) -> str:
    body, speeds = _split_speeds(text, pre=pre)
    if body[:1] not in tuple("ABCD"):
        raise CommandRefused
    axes = unit.resolve_axes(body[:1])
    _check_interpolation(unit, axes, pre=pre)
    pattern = _LINE_AMOUNT_PRE if pre else _LINE_AMOUNT
    groups = [match.groups() for match in split_repeated(pattern, body[1:], len(axes))]
    amounts = tuple(
        _apply_sign(sign, parse_pulses(axis, letter, n)) for axis, (sign, letter, n) in zip(axes, groups, strict=True)
    )
    triple = _first_triple(axes[0], groups[0][1], speeds)
    return _write_buffers(unit, axes, [LinearMove(tuple(axes), amounts, triple, pre)], pre=pre)


def set_line(unit: StageSystem, text: str, reply: Reply) -> str:
    """K: (L4579)."""
    del reply
    return _set_line(unit, text, pre=False)


def set_line_pre(unit: StageSystem, text: str, reply: Reply) -> str:
    """KP: (L4649)."""
    del reply
    return _set_line(unit, text, pre=True)


class _ArcFields:
    """Reads the values of an arc command one after the other."""

    def __init__(self, unit: StageSystem, text: str) -> None:
        self._unit = unit
        self._text = text
        self.first_letter = ""

    def read_amount(self, axis: StageAxis) -> int:
        match = _ARC_AMOUNT.match(self._text)
        if match is None:
            raise CommandRefused
        self._text = self._text[match.end() :]
        sign, letter, number, bare_sign, bare_number = match.groups()
        if letter is None:
            # Printed once without its unit letter (L4091, decision 35).
            if self._unit.options.arc_unit_required:
                raise CommandRefused
            sign, letter, number = bare_sign, "P", bare_number
        self.first_letter = self.first_letter or letter
        return _apply_sign(sign, parse_pulses(axis, letter, number))

    def read_angle(self, max_degrees: int) -> Fraction:
        match = _ANGLE.match(self._text)
        if match is None or len(match[1]) > 20:
            raise CommandRefused
        self._text = self._text[match.end() :]
        angle = Fraction(match[1])
        if not 0 < angle <= max_degrees:
            raise CommandRefused
        return angle

    def require_end(self) -> None:
        if self._text:
            raise CommandRefused


def _set_arc(unit: StageSystem, text: str, *, pre: bool) -> str:
    body, speeds = _split_speeds(text, pre=pre)
    match = _ARC.fullmatch(body)
    if match is None:
        raise CommandRefused
    form, letter, direction, rotations, fields = int(match[1]), match[2], match[3], match[4], match[5]
    helix = form >= 3
    if (helix and letter != "A") or (rotations is not None) != (form == 3):
        raise CommandRefused
    plane = unit.resolve_axes(letter)
    axes = unit.resolve_axes("D") if helix else plane
    _check_interpolation(unit, axes, pre=pre)
    texts = _ArcFields(unit, fields)
    values = tuple(texts.read_amount(plane[at % 2]) for at in range(_VALUES[form]))
    if form in (2, 5):
        try:
            find_circumcentre(*values)
        except CollinearPoints:
            raise CommandRefused from None
    angle = texts.read_angle(_DEGREES[form]) if form in _DEGREES else None
    rise = texts.read_amount(axes[2]) if helix else 0
    texts.require_end()
    arc = ArcMove(
        form=form,
        plane=(plane[0], plane[1]),
        linear=axes[2] if helix else None,
        ccw=direction == "1",
        values=values,
        angle=angle,
        rotations=parse_integer(rotations, 1, _MOST_ROTATIONS) if rotations is not None else 1,
        rise=rise,
        triple=_first_triple(plane[0], texts.first_letter, speeds),
        from_pre=pre,
    )
    return _write_buffers(unit, axes, [arc], pre=pre)


def set_arc(unit: StageSystem, text: str, reply: Reply) -> str:
    """E: (L3349-L3855)."""
    del reply
    return _set_arc(unit, text, pre=False)


def set_arc_pre(unit: StageSystem, text: str, reply: Reply) -> str:
    """EP: (L3859-L4575)."""
    del reply
    return _set_arc(unit, text, pre=True)


def set_jog(unit: StageSystem, text: str, reply: Reply) -> str:
    """J: (L4859); without signs all directions are +."""
    del reply
    axes = unit.resolve_axes(text[:1] or "?")
    unit.require_ready(axes)
    unit.require_error_free(axes)
    signs = text[1:] or "+" * len(axes)
    if len(signs) != len(axes) or signs.strip("+-"):
        raise CommandRefused
    for axis, sign in zip(axes, signs, strict=True):
        unit.chain.set_execution(JogMove(axis, 1 if sign == "+" else -1))
    return "OK"


def _set_standby(unit: StageSystem, text: str, kind: type[TimedStandby] | type[InputStandby]) -> str:
    letter, *values = text.split(",")
    axes = unit.resolve_axes(letter or "?")
    if len(values) == 1 and (values[0] == "C" or letter == "W"):
        # One value applies to all axes (L2631, L2677).
        values *= len(axes)
    if len(values) != len(axes):
        raise CommandRefused
    released_axes: list[StageAxis] = []
    entries: list[Entry] = []
    for axis, value in zip(axes, values, strict=True):
        if value == "C" or (kind is TimedStandby and value.strip("0") == "" and value):
            released_axes.append(axis)
        elif kind is TimedStandby:
            entries.append(TimedStandby(axis, parse_integer(value, 0, 2550)))
        else:
            entries.append(InputStandby(axis, parse_integer(value, 0, 63)))
    options = unit.options
    if options.standby_needs_running and not all(unit.chain.is_deferred(entry.axes) for entry in entries):
        raise CommandRefused
    answer = _write_buffers(unit, axes, entries, pre=True)
    for axis in released_axes:
        unit.chain.cancel_standby(axis, kind)
    return answer if options.standby_reply_deferred else "OK"


def set_wait_time(unit: StageSystem, text: str, reply: Reply) -> str:
    """WT: (L2587); 0 and C end a timed standby (L2593, L215)."""
    del reply
    return _set_standby(unit, text, TimedStandby)


def set_wait_input(unit: StageSystem, text: str, reply: Reply) -> str:
    """WI: (L2633); C ends an input standby (L219)."""
    del reply
    return _set_standby(unit, text, InputStandby)


def start_motion(unit: StageSystem, text: str, reply: Reply) -> str:
    """G and G:a (L4761-L4822)."""
    axes = unit.resolve_axes(text)
    unit.require_ready(axes)
    unit.require_error_free(axes)
    if not unit.chain.start_operations(axes, reply):
        raise CommandRefused
    return "OK"


def delete_entries(unit: StageSystem, text: str, reply: Reply) -> str:
    """GC:a deletes the values of M, A, E and K (L4824)."""
    del reply
    axes = unit.resolve_axes(text)
    unit.require_ready(axes)
    unit.require_power(axes)
    for axis in axes:
        if not isinstance(unit.chain.buffers[axis].execution, JogMove):
            unit.chain.clear_execution(axis)
    return "OK"


def stop_motion(unit: StageSystem, text: str, reply: Reply) -> str:
    """L:a decelerates, L:E stops everything at once (L2955-L3007)."""
    del reply
    if text == "E":
        unit.emergency_stop()
        return "OK"
    axes = unit.resolve_axes(text)
    unit.require_power(axes)
    for axis in axes:
        unit.chain.stop_axis(axis)
    return "OK"


def _arrival_callback(unit: StageSystem, reply: Reply | None) -> Ready:
    """Announce the arrival of the axis, for the commands that promise it (decision 17 after a stop)."""
    announced_ends = (
        (EndCause.END, EndCause.STOPPED, EndCause.LIMIT, EndCause.SOFT_LIMIT)
        if unit.options.completion_after_stop
        else (EndCause.END,)
    )

    def announce_arrival(run: PathRun, ready_ns: int, cause: EndCause) -> None:
        del ready_ns
        if cause in announced_ends and reply is not None:
            reply(run.tracks[0].axis.name)

    return announce_arrival


def return_to_origin(unit: StageSystem, text: str, reply: Reply, head: str) -> str:
    """H, Hm, HRT, HRTm (L2682-L2800). Every method of this simulator finds the same origin."""
    match = _METHOD.fullmatch(head)
    if match is None or int(match[1] or 0) >= len(METHODS):
        raise CommandRefused
    axes = unit.resolve_axes(text)
    unit.require_ready(axes)
    unit.require_error_free(axes)
    at_ns = unit.time.now_ns()
    ready = _arrival_callback(unit, reply if head.startswith("HRT") else None)
    for axis in axes:
        find_origin(unit.drive, axis, at_ns, ready)
    return "OK"


def return_to_zero(unit: StageSystem, text: str, reply: Reply, head: str) -> str:
    """Z and ZRT (L2802-L2881)."""
    axes = unit.resolve_axes(text)
    unit.require_ready(axes)
    unit.require_error_free(axes)
    at_ns = unit.time.now_ns()
    ready = _arrival_callback(unit, reply if head == "ZRT" else None)
    for axis in axes:
        go_to_zero(unit.drive, axis, axis.triple, at_ns, ready)
    return "OK"


def zero_coordinate(unit: StageSystem, text: str, reply: Reply) -> str:
    """R:a (L2883)."""
    del reply
    axes = unit.resolve_axes(text)
    unit.require_ready(axes)
    unit.require_power(axes)
    for axis in axes:
        set_zero(axis)
    return "OK"


def restore_coordinate(unit: StageSystem, text: str, reply: Reply) -> str:
    """RC:a (L2918)."""
    del reply
    axes = unit.resolve_axes(text)
    unit.require_ready(axes)
    unit.require_power(axes)
    for axis in axes:
        undo_zero(axis)
    return "OK"


def move_to_coordinates(unit: StageSystem, targets: Sequence[int], reply: Reply | None) -> None:
    """PIT:G and PAV:G: all controllable axes to these coordinates, pls, with the D: triple."""
    axes = unit.controllable
    unit.require_ready(axes)
    unit.require_error_free(axes)
    at_ns = unit.time.now_ns()
    for axis in axes:
        distance = targets[axis.index] - axis.position - axis.offset
        order = RunOrder(axis.triple, RunKind.MOVE, at_ns, _arrival_callback(unit, reply))
        start_travel(unit.drive, axis, distance, order)
