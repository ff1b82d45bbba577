"""Gearing and cams: GA GM GR, EA EB EC EG EM EP EQ ET (L4378-L5111, L5421-L5580)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.parameters import target_axes
from sim.yaskawa.language.arguments import (
    LETTERS,
    Field,
    canonical_axis,
    compile_values,
    parse_axes,
    parse_fields,
    parse_form,
    split_fields,
)
from sim.yaskawa.language.context import CommandContext, Evaluator
from sim.yaskawa.language.expressions import compile_expression, compile_integer
from sim.yaskawa.language.registry import Outcome, Runner, register_command
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.gearing import select_master


def _split_masters(text: str) -> list[tuple[str, str]]:
    """Split the argument of GA into pairs of slave and master, as they were written."""
    if text[1:2] == "=" and (text[0] in LETTERS + "ABCD*"):
        return [(canonical_axis(text[0]), text[2:])]
    if text[:1] == "~" and text[2:3] == "=":
        return [(text[:2], text[3:])]
    return [(letter, part) for letter, part in zip(LETTERS, split_fields(text), strict=False) if part]


def _parse_master(source: str) -> str:
    """Return the canonical name of a master: an axis, `C` or `D` with an axis, a system, N, or a designator."""
    letter = canonical_axis(source[-1:])
    if len(source) == 2 and source[0] in "CD" and letter in LETTERS:
        return source[0] + letter
    if len(source) == 1 and (letter in LETTERS or source in "STN"):
        return letter if letter in LETTERS else source
    if source.startswith("~"):
        return source
    raise CommandError(4)


@register_command("GA")
def _compile_gear_axis(text: str) -> Runner:
    masters = [(name, _parse_master(source)) for name, source in _split_masters(text)]
    if not masters:
        raise CommandError(50)

    def run_command(c: CommandContext) -> Outcome:
        machine = c.machine
        for name, source in masters:
            for axis in target_axes(c, name):
                if axis.is_moving:
                    raise CommandError(7)
                real = machine.find_axis(source).name if source.startswith("~") else source
                if real in (axis.name, "C" + axis.name):
                    raise CommandError(46)
                select_master(machine.motion, axis, real)
        return None

    return run_command


@register_command("GM")
def _compile_gantry(text: str) -> Runner:
    if not text:
        raise CommandError(50)
    form = parse_form(text)

    def run_command(c: CommandContext) -> Outcome:
        for name, field in form:
            if field is None or isinstance(field, str):
                raise CommandError(51)
            value = fixed.to_integer(field(c))
            if value not in (0, 1):
                raise CommandError(6)
            for axis in target_axes(c, name):
                axis.gear.gantry = bool(value)
        return None

    return run_command


@register_command("EA")
def _compile_cam_master(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "N")
    if len(names) != 1:
        raise CommandError(4)

    def run_command(c: CommandContext) -> Outcome:
        cam = c.machine.motion.cam
        if cam.followers:
            raise CommandError(100)
        cam.master = c.machine.find_axis(names[0]).name
        return None

    return run_command


@register_command("EB")
def _compile_cam_enable(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_integer(int(c.machine.motion.cam.enabled), 1)
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        motion = c.machine.motion
        cam = motion.cam
        switch = value(c)
        if switch not in (0, 1):
            raise CommandError(6)
        if switch:
            if cam.master is None:
                raise CommandError(102)
            if cam.effective_cycle > (cam.points - 1) * cam.interval:
                raise CommandError(103)
            motion.camming.set_modulus(cam.effective_cycle)
        else:
            sample_now = c.machine.timebase.next_sample()
            for name in tuple(cam.followers):
                motion.camming.disengage_slave(motion.axes[name], sample_now)
            cam.waiting.clear()
            motion.camming.set_modulus(0)
        cam.enabled = bool(switch)
        return None

    return run_command


@register_command("EC")
def _compile_cam_counter(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_variable(fixed.from_integer(c.machine.motion.cam.index))
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        index = value(c)
        if not 0 <= index < c.machine.motion.cam.points:
            raise CommandError(6)
        c.machine.motion.cam.index = index
        return None

    return run_command


@register_command("EP")
def _compile_cam_interval(text: str) -> Runner:
    if text in ("?", "?,?", ",?"):
        return lambda c: _show_interval(c, text)
    if not text:
        raise CommandError(50)
    fields = compile_values(parse_fields(text, 2))

    def run_command(c: CommandContext) -> Outcome:
        cam = c.machine.motion.cam
        given_fields = [*fields(c), None]
        if cam.followers:
            raise CommandError(100)
        if given_fields[0] is not None:
            interval = fixed.to_integer(given_fields[0])
            if not 1 <= interval <= 32767:
                raise CommandError(6)
            cam.interval = interval
        if given_fields[1] is not None:
            cam.start = fixed.to_integer(given_fields[1])
        return None

    return run_command


def _show_interval(c: CommandContext, text: str) -> str:
    cam = c.machine.motion.cam
    pairs = zip((cam.interval, cam.start), text.split(","), strict=False)
    return ",".join(c.machine.format_counts(number) for number, mark in pairs if mark)


@register_command("ET")
def _compile_cam_table(text: str) -> Runner:
    index: Evaluator | None = None
    body = text
    if text.startswith("["):
        index_text, mark, body = text[1:].partition("]=")
        if not mark:
            raise CommandError(55)
        index = compile_expression(index_text)
    if not body:
        raise CommandError(50)
    fields = compile_values(parse_fields(body))

    def run_command(c: CommandContext) -> Outcome:
        cam = c.machine.motion.cam
        number = fixed.to_integer(index(c)) if index is not None else cam.index
        if not 0 <= number < cam.points:
            raise CommandError(101)
        for letter, raw in zip(LETTERS, fields(c), strict=False):
            if raw is not None:
                cam.store_point(c.machine.find_axis(letter).name, number, fixed.to_integer(raw))
        if index is None:
            cam.index = min(number + 1, cam.points - 1)
        return None

    return run_command


def engagement_compiler(op: str) -> Callable[[str], Runner]:
    """Make the compiler of EG or EQ."""

    def compile_engagement(text: str) -> Runner:
        if not text:
            raise CommandError(50)
        form = parse_form(text)
        if any(isinstance(field, str) for _, field in form):
            if op == "EG":
                raise CommandError(51)
            return lambda c: ",".join(
                c.machine.format_variable(fixed.from_integer(waiting_state(c, axis.name)))
                for name, _ in form
                for axis in target_axes(c, name)
            )
        return lambda c: _run_engagement(c, op, form)

    return compile_engagement


def _run_engagement(c: CommandContext, op: str, form: list[tuple[str, Field]]) -> Outcome:
    cam = c.machine.motion.cam
    if not cam.enabled or cam.master is None:
        raise CommandError(105)
    for name, field in form:
        if field is None or isinstance(field, str):
            raise CommandError(51)
        position = fixed.to_integer(field(c))
        for axis in target_axes(c, name):
            if axis.name == cam.master:
                raise CommandError(4)
            if axis.is_moving:
                raise CommandError(7)
            if op == "EG" and axis.motor_off:
                raise CommandError(20)
            _change_engagement(c, op, axis, position)
    return None


def _change_engagement(c: CommandContext, op: str, axis: ServoAxis, place: int) -> None:
    """Engage or disengage a slave: at the master's position `place` within its cycle, otherwise at once."""
    motion, cam = c.machine.motion, c.machine.motion.cam
    camming = motion.camming
    at = c.machine.timebase.next_sample()
    if cam.start <= place < cam.start + cam.effective_cycle:
        if not motion.figures.cycles_by_turns:
            cam.waiting.pop((axis.name, "EQ" if op == "EG" else "EG"), None)
        cam.waiting[axis.name, op] = place
        if (camming.master_position(at) - place) % cam.effective_cycle == 0:
            del cam.waiting[axis.name, op]
            (camming.engage_slave if op == "EG" else camming.disengage_slave)(axis, at)
    elif op == "EG":
        camming.engage_slave(axis, at)
    elif axis.mode == "cam":
        camming.disengage_slave(axis, at)


def waiting_state(c: CommandContext, name: str) -> int:
    """`_EQx`: 1 waiting to engage, 2 waiting to disengage, 3 both (SMC-2000: L8634), 0 otherwise."""
    waits = c.machine.motion.cam.waiting
    return ((name, "EG") in waits) + 2 * ((name, "EQ") in waits)


register_command("EG")(engagement_compiler("EG"))
register_command("EQ")(engagement_compiler("EQ"))
