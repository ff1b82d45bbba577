"""Starting, stopping and positioning axes: BG ST AB SH MO DP DE IP HM FE FI AL (L2186-L10160)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.parameters import register_form
from sim.yaskawa.language.arguments import LETTERS, parse_axes, queried_axes
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.expressions import compile_integer
from sim.yaskawa.language.registry import Outcome, Runner, register_command, require_bare
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.codes import ABORT_CODE


def busy_refusal(axis: ServoAxis) -> CommandError:
    """Return the refusal of a command that a moving axis does not accept."""
    return CommandError({"contour": 18, "sequence": 29}.get(axis.mode, 7))


def chosen_axes(c: CommandContext, names: tuple[str, ...]) -> list[ServoAxis]:
    """Return the axes named; all real ones when none is."""
    return [c.machine.find_axis(name) for name in names] if names else list(c.machine.motion.real)


def resolve_names(c: CommandContext, names: tuple[str, ...]) -> list[str]:
    """Return the designators with each `~a` replaced by its axis."""
    return [c.machine.designators.resolve_name(name, unset="?") for name in names]


@register_command("BG")
def _compile_begin(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "NST")

    def run_command(c: CommandContext) -> Outcome:
        machine, motion = c.machine, c.machine.motion
        sample, at = machine.current_sample(), machine.timebase.next_sample()
        wanted_names = resolve_names(c, names)
        systems = [motion.systems[name] for name in wanted_names if name in motion.systems]
        if names:
            axes = [machine.find_axis(name) for name in wanted_names if name not in motion.systems]
        else:
            axes = [axis for axis in motion.real if not axis.motor_off and not axis.is_moving]
            if not axes:
                raise CommandError(20 if any(axis.motor_off for axis in motion.real) else 21)
        if motion.abort_input:
            raise CommandError(22)
        for axis in axes:
            _check_begin(c, axis, sample)
        for system in systems:
            motion.coordinated.check_begin(system, sample)
        motion.independent.begin_motion(axes, at)
        for system in systems:
            motion.coordinated.begin_sequence(system, at)
        return None

    return run_command


def _check_begin(c: CommandContext, axis: ServoAxis, now: int) -> None:
    motion = c.machine.motion
    if axis.mode in ("contour", "sequence"):
        raise busy_refusal(axis)
    if motion.contouring.running is not None and axis.name in motion.contouring.running.axes:
        raise CommandError(18)
    if axis.motor_off:
        raise CommandError(20)
    if axis.is_moving:
        raise CommandError(21)
    if axis.mode == "cam":
        raise CommandError(104)
    if axis.armed in ("HM", "FE"):
        distance = motion.homing.search_direction(axis, now)
    elif axis.armed in ("JG", "FI"):
        distance = axis.registers["JG"]
    elif axis.armed == "PR":
        distance = axis.registers["PR"]
    else:
        distance = axis.registers["PA"] - fixed.from_integer(fixed.round_half_up(axis.command_at(now)))
    if distance and motion.limits.is_blocked(axis, forward=distance > 0, now=now):
        raise CommandError(22)


@register_command("ST")
def _compile_stop(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "NST")

    def run_command(c: CommandContext) -> Outcome:
        machine, motion = c.machine, c.machine.motion
        at = machine.timebase.next_sample()
        wanted_names = resolve_names(c, names) or [*motion.axes, *motion.systems]
        for name in wanted_names:
            if name in motion.systems:
                system = motion.systems[name]
                if system.running:
                    motion.coordinated.stop_sequence(motion.coordinated.member_axes(system)[0], at, 4)
            else:
                motion.stop_axis(machine.find_axis(name), at)
        if not names and c.thread is None and machine.options.st_halts_programs:
            machine.programs.halt_all()
        return None

    return run_command


@register_command("AB")
def _compile_abort(text: str) -> Runner:
    """`AB ?` reports the abort input, as `_AB` does (L2222)."""
    if text == "?":
        return lambda c: c.machine.format_integer(int(not c.machine.motion.abort_input), 1)
    number = compile_integer(text) if text else None

    def run_command(c: CommandContext) -> Outcome:
        value = number(c) if number is not None else 0
        if value not in (0, 1):
            raise CommandError(6)
        c.machine.abort_motion(ABORT_CODE, halt=value == 0)
        return None

    return run_command


@register_command("SH")
def _compile_servo_here(text: str) -> Runner:
    names = parse_axes(text)

    def run_command(c: CommandContext) -> Outcome:
        sample_now = c.machine.current_sample()
        axes = chosen_axes(c, names)
        for axis in axes:
            if axis.is_moving:
                raise busy_refusal(axis)
        for axis in axes:
            c.machine.motion.switch_motor_on(axis, sample_now)
        return None

    return run_command


def compile_flag_query(text: str, read: Callable[[ServoAxis], bool]) -> Runner:
    """Compile `?` in the fields of a command that otherwise takes letters: 1 or 0 for each axis queried."""
    names = queried_axes(text)
    return lambda c: ",".join(c.machine.format_integer(int(read(axis)), 1) for axis in chosen_axes(c, names))


@register_command("MO")
def _compile_motor_off(text: str) -> Runner:
    """`MO ?` reports 1 for a motor that is off (L7599-L7603)."""
    if "?" in text:
        return compile_flag_query(text, lambda axis: axis.motor_off)
    names = parse_axes(text)

    def run_command(c: CommandContext) -> Outcome:
        axes = chosen_axes(c, names)
        for axis in axes:
            if axis.is_moving:
                raise busy_refusal(axis)
        for axis in axes:
            c.machine.motion.switch_motor_off(axis, c.machine.current_sample())
        return None

    return run_command


def _mode_compiler(op: str) -> Callable[[str], Runner]:
    def compile_mode(text: str) -> Runner:
        names = parse_axes(text)

        def run_command(c: CommandContext) -> Outcome:
            axes = chosen_axes(c, names)
            for axis in axes:
                if axis.is_moving:
                    raise busy_refusal(axis)
            for axis in axes:
                axis.armed = op
            return None

        return run_command

    return compile_mode


for _op in ("HM", "FE", "FI"):
    register_command(_op)(_mode_compiler(_op))


@register_command("AL")
def _compile_arm_latch(text: str) -> Runner:
    """`AL ?` reports 1 while the latch is armed (L2543)."""
    if "?" in text:
        return compile_flag_query(text, lambda axis: axis.latch_armed)
    names = parse_axes(text)

    def run_command(c: CommandContext) -> Outcome:
        for axis in chosen_axes(c, names):
            axis.latch_armed = True
        return None

    return run_command


def _define_position(c: CommandContext, given: list[tuple[ServoAxis, int]]) -> None:
    for axis, _ in given:
        if axis.is_moving:
            raise busy_refusal(axis)
        if axis.mode == "cam":
            raise CommandError(104)
    for axis, raw in given:
        axis.define_position(c.machine.current_sample(), fixed.to_integer(raw))


def _define_auxiliary(c: CommandContext, given: list[tuple[ServoAxis, int]]) -> None:
    for axis, raw in given:
        axis.auxiliary = fixed.to_integer(raw)


def increment_target(c: CommandContext, given: list[tuple[ServoAxis, int]]) -> None:
    """`IP`: at rest a move, in a move a farther target, in a jog a jump."""
    machine, motion = c.machine, c.machine.motion
    sample, at = machine.current_sample(), machine.timebase.next_sample()
    for axis, raw in given:
        if axis.mode in ("contour", "sequence"):
            raise busy_refusal(axis)
        if axis.stopping:
            raise CommandError(16)
        if axis.mode == "move" and raw and (raw > 0) != (axis.target >= axis.path.position(sample)):
            raise CommandError(16)
        if not axis.is_moving:
            if axis.motor_off:
                raise CommandError(20)
            if raw and motion.limits.is_blocked(axis, forward=raw > 0, now=sample):
                raise CommandError(22)
    for axis, raw in given:
        step = fixed.to_integer(raw)
        if axis.mode == "move":
            axis.target += step
            motion.plan_profile(axis, at)
        elif axis.mode == "jog" and axis.profile is not None:
            axis.profile.shift_rest(step)
            motion.schedule_axis(axis, at)
        else:
            register, armed_state = axis.registers["PR"], axis.armed
            axis.registers["PR"], axis.armed = fixed.from_integer(step), "PR"
            motion.independent.begin_motion([axis], at)
            axis.registers["PR"], axis.armed = register, armed_state


def move_distance(c: CommandContext, axis: ServoAxis) -> int:
    """`_PR`: the incremental distance, also when PA has set it (L12120; SMC-2000, with `PR ?`: L10845)."""
    if axis.mode == "move":
        return fixed.round_half_up(axis.target) - axis.move_start
    if axis.armed == "PA":
        return fixed.to_integer(axis.registers["PA"]) - axis.reference_at(c.machine.current_sample())
    return fixed.to_integer(axis.registers["PR"])


def _show_reference(c: CommandContext, axis: ServoAxis) -> str:
    return c.machine.format_counts(axis.report_counts(axis.reference_at(c.machine.current_sample())))


def _show_encoder(c: CommandContext, axis: ServoAxis) -> str:
    return c.machine.format_counts(axis.report_counts(axis.actual_at(c.machine.current_sample())))


register_form("DP", _show_encoder, _define_position)
register_form("DE", lambda c, axis: c.machine.format_counts(axis.auxiliary), _define_auxiliary)
register_form("IP", _show_reference, increment_target)


@register_command("TM")
def _compile_time_base(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_integer(c.machine.timebase.period_us, 5)
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        period = value(c)
        low, high, step = c.machine.model.time_bases(len(c.machine.letters))
        if period < 0 and c.machine.model.external_clock:
            c.machine.timebase.set_period(period)
        elif low <= period <= high:
            c.machine.timebase.set_period(period // step * step)
        else:
            raise CommandError(6)
        c.machine.handle_rescheduling()
        return None

    return run_command


@register_command("RS", where="line")
def _compile_reset(text: str) -> Runner:
    require_bare(text)

    def run_command(c: CommandContext) -> Outcome:
        c.machine.reset_controller()
        return None

    return run_command
