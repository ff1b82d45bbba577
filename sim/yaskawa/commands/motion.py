"""Starting, stopping and placing axes: BG ST AB SH MO DP DE IP HM FE FI AL (L2186-L10160)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.parameters import form_command
from sim.yaskawa.language.arguments import LETTERS, parse_axes, questioned
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import integer
from sim.yaskawa.language.registry import Outcome, Runner, bare, command
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.control import ABORT_CODE


def busy(axis: Axis) -> CommandError:
    """The refusal of a command that an axis in motion does not take."""
    return CommandError({"contour": 18, "sequence": 29}.get(axis.mode, 7))


def chosen(c: Context, names: tuple[str, ...]) -> list[Axis]:
    """The axes named; all real ones when none is."""
    return [c.machine.axis(name) for name in names] if names else list(c.machine.motion.real)


def resolve(c: Context, names: tuple[str, ...]) -> list[str]:
    """Designators with `~a` replaced by what it stands for."""
    return [c.machine.designators.get(name, "?") if name.startswith("~") else name for name in names]


@command("BG")
def _begin(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "NST")

    def run(c: Context) -> Outcome:
        machine, motion = c.machine, c.machine.motion
        now, at = machine.now(), machine.timebase.next_sample()
        wanted = resolve(c, names)
        systems = [motion.systems[name] for name in wanted if name in motion.systems]
        if names:
            axes = [machine.axis(name) for name in wanted if name not in motion.systems]
        else:
            axes = [axis for axis in motion.real if not axis.motor_off and not axis.moving]
            if not axes:
                raise CommandError(20 if any(axis.motor_off for axis in motion.real) else 21)
        if motion.abort_input:
            raise CommandError(22)
        for axis in axes:
            _check_begin(c, axis, now)
        for system in systems:
            motion.coordinated.check(system, now)
        motion.begin(axes, at)
        for system in systems:
            motion.coordinated.begin(system, at)
        return None

    return run


def _check_begin(c: Context, axis: Axis, now: int) -> None:
    motion = c.machine.motion
    if axis.mode in ("contour", "sequence"):
        raise busy(axis)
    if motion.contour is not None and axis.name in motion.contour.axes:
        raise CommandError(18)
    if axis.motor_off:
        raise CommandError(20)
    if axis.moving:
        raise CommandError(21)
    if axis.mode == "cam":
        raise CommandError(104)
    if axis.armed in ("HM", "FE"):
        distance = motion.homing.way(axis, now)
    elif axis.armed in ("JG", "FI"):
        distance = axis.registers["JG"]
    elif axis.armed == "PR":
        distance = axis.registers["PR"]
    else:
        distance = axis.registers["PA"] - fixed.whole(fixed.rounded(axis.path.position(now)))
    if distance and motion.blocked(axis, distance > 0, now):
        raise CommandError(22)


@command("ST")
def _stop(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "NST")

    def run(c: Context) -> Outcome:
        machine, motion = c.machine, c.machine.motion
        at = machine.timebase.next_sample()
        wanted = resolve(c, names) or [*motion.axes, *motion.systems]
        for name in wanted:
            if name in motion.systems:
                system = motion.systems[name]
                if system.running:
                    motion.coordinated.stop(motion.coordinated.members(system)[0], at, 4)
            else:
                motion.stop(machine.axis(name), at)
        if not names and c.thread is None and machine.options.st_halts_programs:
            machine.interpreter.halt_all()
        return None

    return run


@command("AB")
def _abort(text: str) -> Runner:
    """`AB ?` tells the abort input, as `_AB` does (L2222)."""
    if text == "?":
        return lambda c: c.machine.show_whole(int(not c.machine.motion.abort_input), 1)
    number = integer(text) if text else None

    def run(c: Context) -> Outcome:
        value = number(c) if number is not None else 0
        if value not in (0, 1):
            raise CommandError(6)
        c.machine.abort(ABORT_CODE, halt=value == 0)
        return None

    return run


@command("SH")
def _servo_here(text: str) -> Runner:
    names = parse_axes(text)

    def run(c: Context) -> Outcome:
        now = c.machine.now()
        axes = chosen(c, names)
        for axis in axes:
            if axis.moving:
                raise busy(axis)
        for axis in axes:
            c.machine.motion.motor_on(axis, now)
        return None

    return run


def flag_query(text: str, read: Callable[[Axis], bool]) -> Runner:
    """`?` in the fields of a command that else takes letters: 1 or 0 for each axis asked."""
    names = questioned(text)
    return lambda c: ",".join(c.machine.show_whole(int(read(axis)), 1) for axis in chosen(c, names))


@command("MO")
def _motor_off(text: str) -> Runner:
    """`MO ?` tells 1 for a motor that is off (L7599-L7603)."""
    if "?" in text:
        return flag_query(text, lambda axis: axis.motor_off)
    names = parse_axes(text)

    def run(c: Context) -> Outcome:
        axes = chosen(c, names)
        for axis in axes:
            if axis.moving:
                raise busy(axis)
        for axis in axes:
            c.machine.motion.motor_off(axis, c.machine.now())
        return None

    return run


def _mode(op: str) -> Callable[[str], Runner]:
    def compile_mode(text: str) -> Runner:
        names = parse_axes(text)

        def run(c: Context) -> Outcome:
            axes = chosen(c, names)
            for axis in axes:
                if axis.moving:
                    raise busy(axis)
            for axis in axes:
                axis.armed = op
            return None

        return run

    return compile_mode


for _op in ("HM", "FE", "FI"):
    command(_op)(_mode(_op))


@command("AL")
def _arm_latch(text: str) -> Runner:
    """`AL ?` tells 1 while the latch is armed (L2543)."""
    if "?" in text:
        return flag_query(text, lambda axis: axis.latch_armed)
    names = parse_axes(text)

    def run(c: Context) -> Outcome:
        for axis in chosen(c, names):
            axis.latch_armed = True
        return None

    return run


def _define(c: Context, given: list[tuple[Axis, int]]) -> None:
    for axis, _ in given:
        if axis.moving:
            raise busy(axis)
        if axis.mode == "cam":
            raise CommandError(104)
    for axis, raw in given:
        axis.define(c.machine.now(), fixed.truncated(raw))


def _define_auxiliary(c: Context, given: list[tuple[Axis, int]]) -> None:
    for axis, raw in given:
        axis.auxiliary = fixed.truncated(raw)


def increment(c: Context, given: list[tuple[Axis, int]]) -> None:
    """`IP`: at rest a move, in a move a farther target, in a jog a jump."""
    machine, motion = c.machine, c.machine.motion
    now, at = machine.now(), machine.timebase.next_sample()
    for axis, raw in given:
        if axis.mode in ("contour", "sequence"):
            raise busy(axis)
        if axis.stopping:
            raise CommandError(16)
        if axis.mode == "move" and raw and (raw > 0) != (axis.target >= axis.path.position(now)):
            raise CommandError(16)
        if not axis.moving:
            if axis.motor_off:
                raise CommandError(20)
            if raw and motion.blocked(axis, raw > 0, now):
                raise CommandError(22)
    for axis, raw in given:
        step = fixed.truncated(raw)
        if axis.mode == "move":
            axis.target += step
            motion.plan(axis, at)
        elif axis.mode == "jog" and axis.profile is not None:
            axis.profile.shift(step)
            motion.schedule(axis, at)
        else:
            kept, armed = axis.registers["PR"], axis.armed
            axis.registers["PR"], axis.armed = fixed.whole(step), "PR"
            motion.begin([axis], at)
            axis.registers["PR"], axis.armed = kept, armed


def distance(c: Context, axis: Axis) -> int:
    """`_PR`: the incremental distance, also when PA has set it (L12120; SMC-2000, with `PR ?`: L10845)."""
    if axis.mode == "move":
        return fixed.rounded(axis.target) - axis.move_start
    if axis.armed == "PA":
        return fixed.truncated(axis.registers["PA"]) - axis.reference(c.machine.now())
    return fixed.truncated(axis.registers["PR"])


def _show_reference(c: Context, axis: Axis) -> str:
    return c.machine.show_counts(axis.reported(axis.reference(c.machine.now())))


def _show_encoder(c: Context, axis: Axis) -> str:
    return c.machine.show_counts(axis.reported(axis.actual(c.machine.now())))


form_command("DP", _show_encoder, _define)
form_command("DE", lambda c, axis: c.machine.show_counts(axis.auxiliary), _define_auxiliary)
form_command("IP", _show_reference, increment)


@command("TM")
def _time_base(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show_whole(c.machine.timebase.period_us, 5)
    value = integer(text)

    def run(c: Context) -> Outcome:
        period = value(c)
        low, high, step = c.machine.model.time_bases(len(c.machine.letters))
        if period < 0 and c.machine.model.external_clock:
            c.machine.timebase.set_period(period)
        elif low <= period <= high:
            c.machine.timebase.set_period(period // step * step)
        else:
            raise CommandError(6)
        c.machine.rescheduled()
        return None

    return run


@command("RS", where="line")
def _reset(text: str) -> Runner:
    bare(text)

    def run(c: Context) -> Outcome:
        c.machine.reset()
        return None

    return run
