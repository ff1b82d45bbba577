"""Status: TP RP TE TD QP QA RL RU TV TT TS TB TC TI SC QR QZ TY (L8481-L9210, L9500-L11120)."""

import struct
from collections.abc import Callable
from dataclasses import dataclass

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import NumberFormat
from sim.yaskawa.base.options import Smc4000Options
from sim.yaskawa.commands.motion import chosen_axes
from sim.yaskawa.language.arguments import LETTERS, parse_axes, queried_axes
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.expressions import compile_integer
from sim.yaskawa.language.registry import COMMANDS, CommandDefinition, Outcome, Runner, register_command, require_bare
from sim.yaskawa.language.statements import RawData
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.profile import SPEED_UNIT
from sim.yaskawa.motion.sequence import CoordinateSystem

_ADDRESSED_BIT = 7
"""Bit of TB in a daisy chain (SMC-2000: L11659)."""
AVERAGED = 256
"""Samples that TV averages over (L11021)."""
_FEED_FORWARD = 1.5e-7
"""Volts of FA for each count/s^2 (L5121)."""
_SPEED_FORWARD = 1.22e-6
"""Volts of FV for each count/s (L5381)."""
_VOLTS = 9.9988

Reader = Callable[[CommandContext, ServoAxis], int]


def encoder_position(c: CommandContext, axis: ServoAxis) -> int:
    """`TP`."""
    return axis.report_counts(axis.actual_at(c.machine.current_sample()))


def reference_position(c: CommandContext, axis: ServoAxis) -> int:
    """`RP`."""
    return axis.report_counts(axis.reference_at(c.machine.current_sample()))


def position_error(c: CommandContext, axis: ServoAxis) -> int:
    """`TE`."""
    return axis.position_error(c.machine.current_sample())


def auxiliary_position(c: CommandContext, axis: ServoAxis) -> int:
    """`TD`: the auxiliary encoder; on a stepper the pulses sent, which KS delays (L14096-L14105)."""
    if not axis.is_stepper:
        return axis.auxiliary
    return axis.reference_at(c.machine.current_sample() - axis.pulse_delay)


def unmodularised_position(c: CommandContext, axis: ServoAxis) -> int:
    """`QP`."""
    return axis.actual_at(c.machine.current_sample())


def latched_position(c: CommandContext, axis: ServoAxis) -> int:
    """`RL`."""
    return axis.latched


def average_velocity(c: CommandContext, axis: ServoAxis) -> int:
    """`TV`: counts/s, averaged over 256 samples."""
    sample_now = c.machine.current_sample()
    return _average_speed(axis, sample_now, axis.command_at(sample_now))


def _average_speed(axis: ServoAxis, now: int, position: float) -> int:
    if axis.frozen is not None:
        return 0
    span = min(AVERAGED, max(now, 1))
    return fixed.round_half_up((position - axis.command_at(now - span)) / span / SPEED_UNIT)


def torque_volts(c: CommandContext, axis: ServoAxis) -> int:
    """`TT`, raw: offset and feed-forwards of an ideal plant (D63)."""
    if axis.motor_off:
        return 0
    bias = axis.registers["OF"] / fixed.ONE
    gain, speed_gain = axis.registers["FA"] / fixed.ONE, axis.registers["FV"] / fixed.ONE
    if gain and axis.profile is not None and axis.is_moving:
        change = axis.profile.acceleration_at(c.machine.current_sample()) * 1048576
        bias += max(min(gain * change * _FEED_FORWARD, 10.0), -10.0)
    if speed_gain:
        bias += speed_gain * axis.command_velocity(c.machine.current_sample()) / SPEED_UNIT * _SPEED_FORWARD
    if not bias:
        return 0
    limit = min(axis.registers["TL"] / fixed.ONE, _VOLTS)
    return fixed.from_real(max(min(bias, limit), -limit))


def switch_states(c: CommandContext, axis: ServoAxis) -> int:
    """`TS` (L10906)."""
    sample_now = c.machine.current_sample()
    return _switch_bits(c, axis, sample_now, axis.reference_at(sample_now), axis.actual_at(sample_now))


def _switch_bits(c: CommandContext, axis: ServoAxis, now: int, command_now: int, encoder_now: int) -> int:
    machine = c.machine
    motion = machine.motion
    active_high = machine.model.switch_levels and machine.polarity[0] > 0
    forward = motion.limits.limit_active(axis, forward=True, now=now) == active_high
    reverse = motion.limits.limit_active(axis, forward=False, now=now) == active_high
    home = machine.environment.home_level(axis.name, encoder_now - axis.physical_zero)
    return (
        axis.is_moving << 7
        | axis.exceeds_error_limit(command_now - encoder_now) << 6
        | axis.motor_off << 5
        | forward << 3
        | reverse << 2
        | home << 1
        | (not axis.latch_armed) << 0
    )


def home_level(c: CommandContext, axis: ServoAxis) -> bool:
    """Return the level of the home input, 1 is high."""
    return c.machine.environment.home_level(axis.name, axis.physical_at(c.machine.current_sample()))


def home_inactive(c: CommandContext, axis: ServoAxis) -> bool:
    """`_HM`: 0 is active whatever CN is set to (L5605)."""
    return home_level(c, axis) != (c.machine.polarity[1] > 0)


def general_status(c: CommandContext) -> int:
    """`TB` (L10220)."""
    machine = c.machine
    programs = machine.programs
    events = {frame.event for frame in programs.threads[0].stack}
    return (
        (machine.selected is True) << _ADDRESSED_BIT
        | programs.any_running() << machine.model.running_bit
        | (machine.motion.contouring.running is not None and machine.motion.contouring.running.started is not None) << 5
        | bool(events & {"CMDERR", "LIMSWI", "POSERR"}) << 4
        | programs.interrupts_on << 3
        | ("ININT" in events) << 2
        | machine.echo << 0
    )


@dataclass(frozen=True, slots=True)
class ReportForm:
    """Form of a report.

    layout: format of its numbers; None: PF.
    digits: for a format that depends on the model.
    allowed: axes that it may name.
    queryable: `?` is another way to name them.
    """

    layout: NumberFormat | None = None
    digits: Callable[[CommandContext], int] | None = None
    allowed: str = LETTERS
    queryable: bool = True

    def number_format(self, c: CommandContext) -> NumberFormat:
        """Return the format of the numbers."""
        return NumberFormat(self.digits(c), 0) if self.digits is not None else self.layout or c.machine.position_format


_PLAIN_FORM = ReportForm()


def register_report(
    op: str, read: Reader, form: ReportForm = _PLAIN_FORM, table: dict[str, CommandDefinition] = COMMANDS
) -> None:
    """Register a command that reports one number of each axis."""

    @register_command(op, table=table)
    def compile_tell(text: str) -> Runner:
        if "?" in text and not form.queryable:
            raise CommandError(51)
        questions = "?" in text
        names = queried_axes(text) if questions else parse_axes(text, form.allowed)

        def run_command(c: CommandContext) -> Outcome:
            if questions and op in c.machine.model.unasked:
                raise CommandError(51)
            layout = form.number_format(c)
            raw = [read(c, axis) if op == "TT" else read(c, axis) * fixed.ONE for axis in chosen_axes(c, names)]
            return report_text(c, ",".join(layout.format_value(value, c.machine.layout) for value in raw))

        return run_command

    del compile_tell


def report_text(c: CommandContext, written: str) -> Outcome:
    """Answer a status command; in a program it is unsolicited text (L3556)."""
    if c.thread is None:
        return written
    c.machine.ports.send_message(f"{written}\r\n")
    return None


register_report("TP", encoder_position, ReportForm(allowed=LETTERS + "N"))
register_report("RP", reference_position, ReportForm(allowed=LETTERS + "N"))
register_report("TE", position_error)
register_report("TD", auxiliary_position)
register_report("QP", unmodularised_position)
register_report("QA", auxiliary_position)
register_report("RL", latched_position)


def _latched_at_rest(c: CommandContext, axis: ServoAxis) -> int:
    """`RU`: not in motion (L9708)."""
    if c.machine.motion.is_active():
        raise CommandError(7)
    return axis.latched


register_report("RU", _latched_at_rest)
register_report("TV", average_velocity, ReportForm(digits=lambda c: c.machine.model.speed_digits))
register_report("TT", torque_volts, ReportForm(NumberFormat(1, 4)))
register_report("TS", switch_states, ReportForm(NumberFormat(3, 0)))
register_report("SC", lambda c, axis: axis.stop_code, ReportForm(NumberFormat(3, 0), allowed=LETTERS + "N"))
register_report("TY", lambda c, axis: axis.absolute, ReportForm(NumberFormat(10, 0)))  # L11089; SMC-2000: L12250


@register_command("TB")
def _compile_tell_status(text: str) -> Runner:
    require_bare(text.removeprefix("?"))
    return lambda c: report_text(c, c.machine.format_integer(general_status(c), 1 if general_status(c) < 10 else 3))


@register_command("TI")
def _compile_tell_inputs(text: str) -> Runner:
    require_bare(text.removeprefix("?"))
    return lambda c: report_text(c, c.machine.format_integer(c.machine.io.input_byte(), 3))


@register_command("TC")
def compile_tell_code(text: str) -> Runner:
    """`TC`: report the reason of the last refusal, once."""
    value = compile_integer(text) if text not in ("", "?") else None

    def run_command(c: CommandContext) -> Outcome:
        number = value(c) if value is not None else 0
        if number not in (0, 1):
            raise CommandError(6)
        code, c.machine.error_code = c.machine.error_code, 0
        if number == 0:
            return report_text(c, c.machine.format_integer(code, 3))
        return report_text(c, f"{code} {c.machine.model.texts[code]}" if code else "0")

    return run_command


@register_command("QZ")
def _compile_record_sizes(text: str) -> Runner:
    require_bare(text)
    planes = 2 * _SYSTEM_BLOCK.size
    return lambda c: report_text(c, f"{len(c.machine.letters)},{_GENERAL_BLOCK.size},{planes},{_axis_bytes(c)}")


# The data record

_GENERAL_BLOCK = struct.Struct("<HB9xB9xBB")
_SYSTEM_BLOCK = struct.Struct("<HHi")
_AXIS_BLOCK = struct.Struct("<HBBiiiiih")


@register_command("QR")
def _compile_data_record(text: str) -> Runner:
    if any(letter not in "ABCDXYZWSTI" for letter in text):
        raise CommandError(4)
    letters = {("XYZW".find(letter) >= 0 and "ABCD"["XYZW".find(letter)]) or letter for letter in text}

    def run_command(c: CommandContext) -> Outcome:
        machine = c.machine
        names = letters or {*"IST", *"ABCD"[: len(machine.letters)]}
        blocks = b""
        header, sample = 0x8000, machine.current_sample()
        padding = bytes(_axis_bytes(c) - _AXIS_BLOCK.size)
        if "I" in names:
            header |= 0x400
            blocks += _general_block(c)
        for system in "ST":
            if system in names:
                header |= 0x100 if system == "S" else 0x200
                blocks += _system_block(c, machine.motion.systems[system])
        for index, letter in enumerate("ABCD"):
            if letter in names:
                header |= 1 << index
                blocks += _axis_block(c, machine.find_axis("XYZW"[index]), sample) + padding
        data = struct.pack("<HH", header, len(blocks) + 4) + blocks
        if c.port is None:
            machine.ports.send_message(data.decode("latin-1"))
            return None
        return RawData(data.decode("latin-1"))

    return run_command


def _general_block(c: CommandContext) -> bytes:
    machine = c.machine
    status = (
        machine.programs.any_running() << 7
        | bool(machine.programs.threads[0].input_for) << 2
        | machine.programs.trace << 1
        | machine.echo << 0
    )
    inputs, outputs = machine.io.input_byte(), machine.io.outputs
    return _GENERAL_BLOCK.pack(machine.time_counter() & 0xFFFF, inputs, outputs, min(machine.error_code, 255), status)


def _system_block(c: CommandContext, system: CoordinateSystem) -> bytes:
    sample_now = c.machine.current_sample()
    status = 0
    if system.running and system.profile is not None:
        acceleration = system.profile.acceleration_at(sample_now)
        status = 1 << 15 | (acceleration == 0) << 5 | system.stopping << 4 | (acceleration < 0) << 3
    return _SYSTEM_BLOCK.pack(
        system.segment_index(sample_now) & 0xFFFF, status, fixed.wrap_counts(int(system.travelled_distance(sample_now)))
    )


def _axis_block(c: CommandContext, axis: ServoAxis, now: int) -> bytes:
    """Pack an axis block."""
    return _AXIS_BLOCK.pack(*axis_values(c, axis, now))


def axis_values(c: CommandContext, axis: ServoAxis, now: int) -> tuple[int, ...]:
    """Return the nine values of an axis block: status, switches, stop code, positions (reference, motor, error,
    auxiliary), velocity, torque. The command is evaluated once for all of them: the record is the one that hosts
    poll."""
    command = axis.command_at(now)
    command_now = fixed.wrap_counts(fixed.round_half_up(command))
    encoder_now = axis.actual_at(now)
    return (
        _axis_status(axis, now),
        _axis_switches(c, axis, _switch_bits(c, axis, now, command_now, encoder_now)),
        axis.stop_code,
        axis.report_counts(command_now),
        axis.report_counts(encoder_now),
        fixed.wrap_counts(command_now - encoder_now),
        auxiliary_position(c, axis),
        fixed.wrap_counts(_average_speed(axis, now, command) * 64),
        max(min(round(torque_volts(c, axis) / fixed.ONE / 10.0 * 32767), 32767), -32767),
    )


def _axis_bytes(c: CommandContext) -> int:
    options = c.machine.options
    return options.qr_axis_bytes if isinstance(options, Smc4000Options) else 0


def _axis_switches(c: CommandContext, axis: ServoAxis, state: int) -> int:
    latch_input = axis.index < 8 and c.machine.environment.inputs[axis.index]
    has_captured = not axis.latch_armed and axis.latch_used
    return has_captured << 7 | latch_input << 6 | state & 0x0E


def _axis_status(axis: ServoAxis, now: int) -> int:
    profile, is_moving = axis.profile, axis.is_moving
    slope = profile.acceleration_at(now) if profile is not None and is_moving else 0.0
    rate = axis.command_velocity(now) if axis.mode or axis.gear.on else 0.0
    positioning = axis.armed in ("PR", "PA")
    return (
        is_moving << 15
        | positioning << 14
        | (axis.armed == "PA") << 13
        | (axis.mode == "edge") << 12
        | (axis.mode == "home") << 11
        | (axis.home_stage >= 1) << 10
        | (axis.home_stage >= 2) << 9
        | (axis.mode == "sequence") << 8
        | (rate < 0) << 7
        | (axis.mode == "contour") << 6
        | (is_moving and slope == 0 and rate != 0) << 5
        | axis.stopping << 4
        | (axis.mode == "move" and slope * rate < 0) << 3
        | axis.latch_armed << 2
        | axis.off_on_error << 1
        | axis.motor_off << 0
    )
