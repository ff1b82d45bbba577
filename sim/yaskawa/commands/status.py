"""Status: TP RP TE TD QP QA RL RU TV TT TS TB TC TI SC QR QZ TY (L8481-L9210, L9500-L11120)."""

import struct
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import Format
from sim.yaskawa.base.options import Smc4000Options
from sim.yaskawa.commands.motion import chosen
from sim.yaskawa.language.arguments import LETTERS, parse_axes, questioned
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import integer
from sim.yaskawa.language.registry import COMMANDS, Command, Outcome, Runner, bare, command
from sim.yaskawa.language.statements import Raw
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.profile import SPEED_UNIT
from sim.yaskawa.motion.sequence import System

_ADDRESSED_BIT = 7
"""Of TB in a daisy chain (SMC-2000: L11659)."""
AVERAGED = 256
"""Samples that TV averages over (L11021)."""
_FEED_FORWARD = 1.5e-7
"""Volts of FA for each count/s^2 (L5121)."""
_SPEED_FORWARD = 1.22e-6
"""Volts of FV for each count/s (L5381)."""
_VOLTS = 9.9988

Reader = Callable[[Context, Axis], int]


def encoder(c: Context, axis: Axis) -> int:
    """`TP`."""
    return axis.reported(axis.actual(c.machine.now()))


def reference(c: Context, axis: Axis) -> int:
    """`RP`."""
    return axis.reported(axis.reference(c.machine.now()))


def error(c: Context, axis: Axis) -> int:
    """`TE`."""
    return axis.error(c.machine.now())


def auxiliary(c: Context, axis: Axis) -> int:
    """`TD`: the auxiliary encoder; on a stepper the pulses sent, which KS delays (L14096-L14105)."""
    if not axis.stepper:
        return axis.auxiliary
    return axis.reference(c.machine.now() - axis.pulse_delay)


def unmodularised(c: Context, axis: Axis) -> int:
    """`QP`."""
    return axis.actual(c.machine.now())


def latched(c: Context, axis: Axis) -> int:
    """`RL`."""
    return axis.latched


def velocity(c: Context, axis: Axis) -> int:
    """`TV`: counts/s, averaged over 256 samples."""
    now = c.machine.now()
    return _speed(axis, now, axis.command(now))


def _speed(axis: Axis, now: int, here: float) -> int:
    if axis.frozen is not None:
        return 0
    span = min(AVERAGED, max(now, 1))
    return fixed.rounded((here - axis.command(now - span)) / span / SPEED_UNIT)


def volts(c: Context, axis: Axis) -> int:
    """`TT`, raw: offset and feed-forwards of an ideal plant (D63)."""
    if axis.motor_off:
        return 0
    bias = axis.registers["OF"] / fixed.ONE
    gain, speed_gain = axis.registers["FA"] / fixed.ONE, axis.registers["FV"] / fixed.ONE
    if gain and axis.profile is not None and axis.moving:
        change = axis.profile.acceleration(c.machine.now()) * 1048576
        bias += max(min(gain * change * _FEED_FORWARD, 10.0), -10.0)
    if speed_gain:
        bias += speed_gain * axis.command_velocity(c.machine.now()) / SPEED_UNIT * _SPEED_FORWARD
    if not bias:
        return 0
    limit = min(axis.registers["TL"] / fixed.ONE, _VOLTS)
    return fixed.of(max(min(bias, limit), -limit))


def switches(c: Context, axis: Axis) -> int:
    """`TS` (L10906)."""
    now = c.machine.now()
    return _switch_bits(c, axis, now, axis.reference(now), axis.actual(now))


def _switch_bits(c: Context, axis: Axis, now: int, command_now: int, encoder_now: int) -> int:
    machine = c.machine
    motion = machine.motion
    active_high = machine.model.switch_levels and machine.polarity[0] > 0
    forward = motion.limit_active(axis, True, now) == active_high
    reverse = motion.limit_active(axis, False, now) == active_high
    home = machine.world.home_level(axis.name, encoder_now - axis.physical_zero)
    return (
        axis.moving << 7
        | machine.events.beyond(axis, command_now - encoder_now) << 6
        | axis.motor_off << 5
        | forward << 3
        | reverse << 2
        | home << 1
        | (not axis.latch_armed) << 0
    )


def home_level(c: Context, axis: Axis) -> bool:
    """Level of the home input, 1 is high."""
    return c.machine.world.home_level(axis.name, axis.physical(c.machine.now()))


def home_inactive(c: Context, axis: Axis) -> bool:
    """`_HM`: 0 is active whatever CN says (L5605)."""
    return home_level(c, axis) != (c.machine.polarity[1] > 0)


def general(c: Context) -> int:
    """`TB` (L10220)."""
    machine = c.machine
    interpreter = machine.interpreter
    events = {frame.event for frame in interpreter.threads[0].stack}
    return (
        (machine.selected is True) << _ADDRESSED_BIT
        | interpreter.any_running() << machine.model.running_bit
        | (machine.motion.contour is not None and machine.motion.contour.started is not None) << 5
        | bool(events & {"CMDERR", "LIMSWI", "POSERR"}) << 4
        | interpreter.interrupts_on << 3
        | ("ININT" in events) << 2
        | machine.echo << 0
    )


def tell(
    op: str,
    read: Reader,
    form: Format | None = None,
    allowed: str = LETTERS,
    digits: Callable[[Context], int] | None = None,
    table: dict[str, Command] = COMMANDS,
    asked: bool = True,
) -> None:
    """Enter a command that tells one number of each axis; `asked` when `?` is another way to name them."""

    @command(op, table=table)
    def compile_tell(text: str) -> Runner:
        if "?" in text and not asked:
            raise CommandError(51)
        questions = "?" in text
        names = questioned(text) if questions else parse_axes(text, allowed)

        def run(c: Context) -> Outcome:
            if questions and op in c.machine.model.unasked:
                raise CommandError(51)
            layout = Format(digits(c), 0) if digits is not None else form or c.machine.position_format
            raw = [read(c, axis) if op == "TT" else read(c, axis) * fixed.ONE for axis in chosen(c, names)]
            return report(c, ",".join(layout.write(value, c.machine.layout) for value in raw))

        return run

    del compile_tell


def report(c: Context, written: str) -> Outcome:
    """The answer to a status command; in a program it is unsolicited text (L3556)."""
    if c.thread is None:
        return written
    c.machine.ports.message(f"{written}\r\n")
    return None


tell("TP", encoder, allowed=LETTERS + "N")
tell("RP", reference, allowed=LETTERS + "N")
tell("TE", error)
tell("TD", auxiliary)
tell("QP", unmodularised)
tell("QA", auxiliary)
tell("RL", latched)


def _latched_at_rest(c: Context, axis: Axis) -> int:
    """`RU`: not in motion (L9708)."""
    if c.machine.motion.active():
        raise CommandError(7)
    return axis.latched


tell("RU", _latched_at_rest)
tell("TV", velocity, digits=lambda c: c.machine.model.speed_digits)
tell("TT", volts, Format(1, 4))
tell("TS", switches, Format(3, 0))
tell("SC", lambda c, axis: axis.stop_code, Format(3, 0), allowed=LETTERS + "N")
tell("TY", lambda c, axis: axis.absolute, Format(10, 0))  # L11089; SMC-2000: L12250


@command("TB")
def _tell_status(text: str) -> Runner:
    bare(text.removeprefix("?"))
    return lambda c: report(c, c.machine.show_whole(general(c), 1 if general(c) < 10 else 3))


@command("TI")
def _tell_inputs(text: str) -> Runner:
    bare(text.removeprefix("?"))
    return lambda c: report(c, c.machine.show_whole(c.machine.io.input_byte(), 3))


@command("TC")
def tell_code(text: str) -> Runner:
    """`TC`: why the last command was refused; told once."""
    value = integer(text) if text not in ("", "?") else None

    def run(c: Context) -> Outcome:
        number = value(c) if value is not None else 0
        if number not in (0, 1):
            raise CommandError(6)
        code, c.machine.error_code = c.machine.error_code, 0
        if number == 0:
            return report(c, c.machine.show_whole(code, 3))
        return report(c, f"{code} {c.machine.model.texts[code]}" if code else "0")

    return run


@command("QZ")
def _record_sizes(text: str) -> Runner:
    bare(text)
    return lambda c: report(c, f"{len(c.machine.letters)},24,8,{_axis_bytes(c)}")


# The data record

_AXIS_BLOCK = struct.Struct("<HBBiiiiih")


@command("QR")
def _data_record(text: str) -> Runner:
    if any(letter not in "ABCDXYZWSTI" for letter in text):
        raise CommandError(4)
    wanted = {("XYZW".find(letter) >= 0 and "ABCD"["XYZW".find(letter)]) or letter for letter in text}

    def run(c: Context) -> Outcome:
        machine = c.machine
        names = wanted or {*"IST", *"ABCD"[: len(machine.letters)]}
        blocks = b""
        header, now = 0x8000, machine.now()
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
                blocks += _axis_block(c, machine.axis("XYZW"[index]), now) + padding
        data = struct.pack("<HH", header, len(blocks) + 4) + blocks
        if c.port is None:
            machine.ports.message(data.decode("latin-1"))
            return None
        return Raw(data.decode("latin-1"))

    return run


def _general_block(c: Context) -> bytes:
    machine = c.machine
    status = (
        machine.interpreter.any_running() << 7
        | bool(machine.interpreter.threads[0].input_for) << 2
        | machine.interpreter.trace << 1
        | machine.echo << 0
    )
    inputs, outputs = machine.io.input_byte(), machine.io.outputs
    return struct.pack(
        "<HB9xB9xBB", machine.time_counter() & 0xFFFF, inputs, outputs, min(machine.error_code, 255), status
    )


def _system_block(c: Context, system: System) -> bytes:
    now = c.machine.now()
    status = 0
    if system.running and system.profile is not None:
        acceleration = system.profile.acceleration(now)
        status = 1 << 15 | (acceleration == 0) << 5 | system.stopping << 4 | (acceleration < 0) << 3
    return struct.pack("<HHi", system.index(now) & 0xFFFF, status, fixed.wrapped(int(system.travelled(now))))


def _axis_block(c: Context, axis: Axis, now: int) -> bytes:
    """The command is worked out once for all that is told about it: the record is what hosts poll."""
    here = axis.command(now)
    command_now = fixed.wrapped(fixed.rounded(here))
    encoder_now = axis.actual(now)
    return _AXIS_BLOCK.pack(
        _axis_status(axis, now),
        _axis_switches(c, axis, _switch_bits(c, axis, now, command_now, encoder_now)),
        axis.stop_code,
        axis.reported(command_now),
        axis.reported(encoder_now),
        fixed.wrapped(command_now - encoder_now),
        auxiliary(c, axis),
        fixed.wrapped(_speed(axis, now, here) * 64),
        max(min(round(volts(c, axis) / fixed.ONE / 10.0 * 32767), 32767), -32767),
    )


def _axis_bytes(c: Context) -> int:
    options = c.machine.options
    return options.qr_axis_bytes if isinstance(options, Smc4000Options) else 0


def _axis_switches(c: Context, axis: Axis, state: int) -> int:
    latch_input = axis.index < 8 and c.machine.world.inputs[axis.index]
    captured = not axis.latch_armed and axis.latch_used
    return captured << 7 | latch_input << 6 | state & 0x0E


def _axis_status(axis: Axis, now: int) -> int:
    profile, moving = axis.profile, axis.moving
    slope = profile.acceleration(now) if profile is not None and moving else 0.0
    rate = axis.command_velocity(now) if axis.mode or axis.gear.on else 0.0
    positioning = axis.armed in ("PR", "PA")
    return (
        moving << 15
        | positioning << 14
        | (axis.armed == "PA") << 13
        | (axis.mode == "edge") << 12
        | (axis.mode == "home") << 11
        | (axis.home_stage >= 1) << 10
        | (axis.home_stage >= 2) << 9
        | (axis.mode == "sequence") << 8
        | (rate < 0) << 7
        | (axis.mode == "contour") << 6
        | (moving and slope == 0 and rate != 0) << 5
        | axis.stopping << 4
        | (axis.mode == "move" and slope * rate < 0) << 3
        | axis.latch_armed << 2
        | axis.off_on_error << 1
        | axis.motor_off << 0
    )
