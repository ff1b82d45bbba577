"""Contour mode: CM, DT, CD, WC (L3439-L3636, L4267-L4331, L11712-L11757)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.arguments import LETTERS, compile_values, parse_axes, parse_fields, parse_form
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.expressions import compile_integer
from sim.yaskawa.language.registry import Outcome, Runner, register_command, require_bare
from sim.yaskawa.motion.contour import ContourMotion, ContourPath, ContourRecord
from sim.yaskawa.motion.control import MotionControl
from sim.yaskawa.motion.trippoints import when_passed


@register_command("CM")
def _compile_contour_mode(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_answer("CM", fixed.from_integer(contour_full(c)))
    names = parse_axes(text)

    def run_command(c: CommandContext) -> Outcome:
        chosen_names = {c.machine.find_axis(name).name for name in names} or set(c.machine.letters)
        axes = tuple(name for name in c.machine.letters if name in chosen_names)
        c.machine.motion.contouring.enter_contour(axes, c.machine.current_sample())
        return None

    return run_command


def contour_full(c: CommandContext) -> int:
    """`_CM`: 1 while a record waits for the executing one (D12)."""
    contour = c.machine.motion.contouring.running
    return int(contour is not None and contour.waiting is not None)


@register_command("DT")
def _compile_interval(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_integer(c.machine.motion.contouring.interval, 1)
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        exponent = value(c)
        if not 0 <= exponent <= 8:
            raise CommandError(6)
        c.machine.motion.contouring.interval = exponent
        return None

    return run_command


@register_command("CD")
def _compile_record(text: str) -> Runner:
    if "=" in text:
        form = parse_form(text)
        if any(isinstance(field, str) for _, field in form):
            raise CommandError(51)
    else:
        form = []
    fields = compile_values(parse_fields(text)) if not form else None

    def run_command(c: CommandContext) -> Outcome:
        motion = c.machine.motion
        contour = motion.contouring.running
        increments: dict[str, int] = {}
        if fields is not None:
            for letter, raw in zip(LETTERS, fields(c), strict=False):
                increments[letter] = 0 if raw is None else fixed.to_integer(raw)
        for name, field in form:
            if field is not None and not isinstance(field, str):
                targets = contour.axes if name == "*" and contour is not None else (c.machine.find_axis(name).name,)
                increments.update(dict.fromkeys(targets, fixed.to_integer(field(c))))
        if any(abs(increment) > c.machine.model.figures.contour_step for increment in increments.values()):
            raise CommandError(41)
        if contour is None:
            if motion.contouring.interval == 0 and not any(increments.values()):
                return None
            raise CommandError(8)
        _queue_record(c, contour, tuple(increments.get(name, 0) for name in contour.axes))
        return None

    return run_command


def _queue_record(c: CommandContext, contour: ContourMotion, increments: tuple[int, ...]) -> None:
    machine, motion = c.machine, c.machine.motion
    exponent = motion.contouring.interval
    record = ContourRecord(increments, 1 << exponent if exponent else 0)
    at = machine.timebase.next_sample()
    if contour.is_executing:
        contour.waiting = record
        return
    if not exponent:
        motion.contouring.leave_contour(at)
        return
    if motion.contouring.is_late:
        motion.contouring.is_late = False
        machine.refuse_command(42)
        if machine.options.late_contour_error:
            raise CommandError(42)
    if contour.started is None:
        for name in contour.axes:
            axis = machine.find_axis(name)
            if axis.motor_off:
                raise CommandError(20)
        contour.begin_from(tuple(machine.find_axis(name).path.position(at) for name in contour.axes))
        for index, name in enumerate(contour.axes):
            axis = machine.find_axis(name)
            axis.path, axis.profile = ContourPath(contour, index), None
            axis.mode, axis.stopping, axis.stop_code = "contour", False, 50
            axis.move_start, axis.mark = axis.reference_at(at), axis.command_at(at)
            motion.record.note_start(axis, at)
    contour.execute_record(record, at)


def _takes_record(motion: MotionControl) -> bool:
    """Return whether no record waits."""
    return motion.contouring.running is None or motion.contouring.running.waiting is None


@register_command("WC")
def _compile_wait_contour(text: str) -> Runner:
    require_bare(text)
    return lambda c: when_passed(lambda machine, sample: _takes_record(machine.motion))
