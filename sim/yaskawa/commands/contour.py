"""Contour mode: CM, DT, CD, WC (L3439-L3636, L4267-L4331, L11712-L11757)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.arguments import LETTERS, parse_axes, parse_fields, parse_form, values
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import integer
from sim.yaskawa.language.registry import Outcome, Runner, bare, command
from sim.yaskawa.motion.contour import Contour, ContourPath, Record
from sim.yaskawa.motion.trippoints import when


@command("CM")
def _contour_mode(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show("CM", fixed.whole(full(c)))
    names = parse_axes(text)

    def run(c: Context) -> Outcome:
        chosen = {c.machine.axis(name).name for name in names} or set(c.machine.letters)
        axes = tuple(name for name in c.machine.letters if name in chosen)
        c.machine.motion.enter_contour(axes, c.machine.now())
        return None

    return run


def full(c: Context) -> int:
    """`_CM`: 1 while a record waits behind the executing one (D12)."""
    contour = c.machine.motion.contour
    return int(contour is not None and contour.waiting is not None)


@command("DT")
def _interval(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show_whole(c.machine.motion.contour_interval, 1)
    value = integer(text)

    def run(c: Context) -> Outcome:
        exponent = value(c)
        if not 0 <= exponent <= 8:
            raise CommandError(6)
        c.machine.motion.contour_interval = exponent
        return None

    return run


@command("CD")
def _record(text: str) -> Runner:
    if "=" in text:
        form = parse_form(text)
        if any(isinstance(field, str) for _, field in form):
            raise CommandError(51)
    else:
        form = []
    fields = values(parse_fields(text)) if not form else None

    def run(c: Context) -> Outcome:
        motion = c.machine.motion
        contour = motion.contour
        given: dict[str, int] = {}
        if fields is not None:
            for letter, raw in zip(LETTERS, fields(c), strict=False):
                given[letter] = 0 if raw is None else fixed.truncated(raw)
        for name, field in form:
            if field is not None and not isinstance(field, str):
                targets = contour.axes if name == "*" and contour is not None else (c.machine.axis(name).name,)
                given.update(dict.fromkeys(targets, fixed.truncated(field(c))))
        if any(abs(increment) > c.machine.model.figures.contour_step for increment in given.values()):
            raise CommandError(41)
        if contour is None:
            if motion.contour_interval == 0 and not any(given.values()):
                return None
            raise CommandError(8)
        _take(c, contour, tuple(given.get(name, 0) for name in contour.axes))
        return None

    return run


def _take(c: Context, contour: Contour, increments: tuple[int, ...]) -> None:
    machine, motion = c.machine, c.machine.motion
    exponent = motion.contour_interval
    record = Record(increments, 1 << exponent if exponent else 0)
    at = machine.timebase.next_sample()
    if contour.executing:
        contour.waiting = record
        return
    if not exponent:
        motion.leave_contour(at)
        return
    if motion.contour_late:
        motion.contour_late = False
        machine.fail(42)
        if machine.options.late_contour_error:
            raise CommandError(42)
    if contour.started is None:
        for name in contour.axes:
            axis = machine.axis(name)
            if axis.motor_off:
                raise CommandError(20)
        for index, name in enumerate(contour.axes):
            axis = machine.axis(name)
            axis.path, axis.profile = ContourPath(contour, index), None
            axis.mode, axis.stopping, axis.stop_code = "contour", False, 50
            axis.move_start, axis.mark = axis.reference(at), axis.command(at)
            motion.note_start(axis, at)
    contour.execute(record, at)


@command("WC")
def _wait_contour(text: str) -> Runner:
    bare(text)
    return lambda c: when(lambda machine, now: machine.motion.contour is None or machine.motion.contour.waiting is None)
