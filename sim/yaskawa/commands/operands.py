"""Operands `_XX`: reading parameters and status in expressions (L11937-L12206, L15800)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.data import ARRAYS
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands import status
from sim.yaskawa.commands.contour import contour_full
from sim.yaskawa.commands.flow import breakpoint_value
from sim.yaskawa.commands.gear import waiting_state
from sim.yaskawa.commands.motion import move_distance
from sim.yaskawa.commands.sequence import OPERAND_READERS, find_system
from sim.yaskawa.commands.system import HANDLES, UNUSED
from sim.yaskawa.language.arguments import LETTERS, canonical_axis
from sim.yaskawa.language.context import CommandContext, Evaluator
from sim.yaskawa.language.parameters import SMC4000
from sim.yaskawa.language.registry import OPERANDS, register_operand
from sim.yaskawa.language.smc2000_parameters import SMC2000
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.sequence import CoordinateSystem

_SPEED_TO_REGISTER = 1024


def _axis_name(suffix: str) -> str:
    """Return the axis of an operand; X when none is given."""
    if not suffix:
        return "X"
    name = suffix if suffix.startswith("~") else canonical_axis(suffix)
    if not name.startswith("~") and name not in LETTERS + "N":
        raise CommandError(58)
    return name


def register_axis_operand(
    op: str,
    read: Callable[[CommandContext, ServoAxis], int],
    *,
    raw: bool = False,
    virtual: bool = False,
    table: dict[str, Callable[[str], Evaluator]] = OPERANDS,
) -> None:
    """Register an operand of one axis; `raw` when `read` gives units of 1/65536.

    virtual: axis N has it, too."""

    def compile_axis(suffix: str) -> Evaluator:
        name = _axis_name(suffix)
        factor = 1 if raw else fixed.ONE

        def evaluate_axis(c: CommandContext) -> int:
            axis = c.machine.find_axis(name)
            if axis.virtual and not virtual:
                raise CommandError(58)
            return read(c, axis) * factor

        return evaluate_axis

    register_operand(op, table=table)(compile_axis)


def _register_parameter(op: str) -> None:
    def read_value(c: CommandContext, axis: ServoAxis) -> int:
        return axis.registers[op]

    register_axis_operand(op, read_value, raw=True, virtual=op in SMC4000 and SMC4000[op].virtual)


for _op in SMC4000.keys() | SMC2000.keys():
    if _op not in ("PA", "JG", "PR"):
        _register_parameter(_op)


def _absolute_position(c: CommandContext, axis: ServoAxis) -> int:
    """`_PA`: start position while moving, commanded position otherwise (D46)."""
    return axis.move_start if axis.is_moving else axis.report_counts(axis.reference_at(c.machine.current_sample()))


def _motion_begun(c: CommandContext, axis: ServoAxis) -> int:
    return int(axis.is_moving)


def _limit_active(c: CommandContext, axis: ServoAxis, *, forward: bool) -> bool:
    return c.machine.motion.limits.limit_active(axis, forward=forward, now=c.machine.current_sample())


register_axis_operand("PA", _absolute_position, virtual=True)
register_axis_operand("PR", move_distance, virtual=True)
register_axis_operand("JG", lambda c, axis: abs(axis.registers["JG"]), raw=True, virtual=True)
register_axis_operand("BG", _motion_begun, virtual=True)
register_axis_operand("MO", lambda c, axis: int(axis.motor_off))
register_axis_operand("SC", lambda c, axis: axis.stop_code, virtual=True)
register_axis_operand("TS", status.switch_states)
register_axis_operand("AL", lambda c, axis: int(axis.latch_armed))
register_axis_operand("TP", status.encoder_position, virtual=True)
register_axis_operand("DP", status.encoder_position, virtual=True)
register_axis_operand("IP", status.reference_position)
register_axis_operand("RP", status.reference_position, virtual=True)
register_axis_operand("SH", status.reference_position)
register_axis_operand("TE", status.position_error)
register_axis_operand("TD", status.auxiliary_position)
register_axis_operand("DE", lambda c, axis: axis.auxiliary)
register_axis_operand("QP", status.unmodularised_position)
register_axis_operand("QA", status.auxiliary_position)
register_axis_operand("RL", status.latched_position)
register_axis_operand("RU", status.latched_position)
register_axis_operand("TV", status.average_velocity)
register_axis_operand("TT", status.torque_volts, raw=True)
register_axis_operand("TY", lambda c, axis: axis.absolute)
register_axis_operand("GM", lambda c, axis: int(axis.gear.gantry))
register_axis_operand("EG", lambda c, axis: int(axis.mode == "cam"))
register_axis_operand("EQ", lambda c, axis: waiting_state(c, axis.name))
register_axis_operand(
    "LF",
    lambda c, axis: int(not _limit_active(c, axis, forward=True)),
)
register_axis_operand(
    "LR",
    lambda c, axis: int(not _limit_active(c, axis, forward=False)),
)
register_axis_operand("HM", lambda c, axis: int(status.home_inactive(c, axis)))


def _register_system_operand(op: str, read: Callable[[CommandContext, CoordinateSystem], float]) -> None:
    def compile_system(suffix: str) -> Evaluator:
        if suffix not in ("", "S", "T"):
            raise CommandError(58)
        return lambda c: fixed.from_real(read(c, find_system(c, suffix)))

    register_operand(op)(compile_system)


def _register_system_register(op: str, read: Callable[[CoordinateSystem], float]) -> None:
    _register_system_operand(op, lambda c, system: read(system))


for _op, _read in OPERAND_READERS.items():
    _register_system_register(_op, _read)
_register_system_operand("AV", lambda c, system: system.travelled_distance(c.machine.current_sample()))
_register_system_operand("CS", lambda c, system: _segment_number(c, system))
_register_system_operand("LM", lambda c, system: system.free_entries(c.machine.current_sample()))
_register_system_operand("LE", lambda c, system: system.length)
_register_system_operand("VE", lambda c, system: system.length)
_register_system_operand(
    "VM",
    lambda c, system: system.path_velocity(c.machine.current_sample()) * _SPEED_TO_REGISTER if system.running else 0.0,
)
_register_system_operand("TN", lambda c, system: _first_tangent(system))


def _segment_number(c: CommandContext, system: CoordinateSystem) -> int:
    contour = c.machine.motion.contouring.running
    if contour is not None and not system.running:
        return contour.count
    return system.segment_index(c.machine.current_sample())


def _first_tangent(system: CoordinateSystem) -> float:
    """Return the position of the tangent axis at the first point (L10790)."""
    if not system.segments:
        return 0.0
    return system.tangent_zero + system.tangent_scale * system.segments[0].heading_at(0.0)


@register_operand("VP")
def _compile_vector_position(suffix: str) -> Evaluator:
    name = _axis_name(suffix)

    def read_value(c: CommandContext) -> int:
        axis = c.machine.find_axis(name).name
        for system in c.machine.motion.systems.values():
            if axis in system.axes:
                index = system.axes.index(axis)
                return fixed.from_real(system.segment_start(c.machine.current_sample())[index])
        return 0

    return read_value


def register_machine_operand(
    op: str,
    read: Callable[[CommandContext], int],
    suffixes: tuple[str, ...] = ("",),
    table: dict[str, Callable[[str], Evaluator]] = OPERANDS,
) -> None:
    """Register an operand of the whole controller."""

    def compile_plain(suffix: str) -> Evaluator:
        if suffix not in suffixes:
            raise CommandError(58)
        return lambda c: fixed.from_integer(read(c))

    register_operand(op, table=table)(compile_plain)


register_machine_operand("AB", lambda c: int(not c.machine.motion.abort_input))
register_machine_operand("AE", lambda c: c.machine.last_encoder, ("", *LETTERS[:4], *"ABCD"))
register_machine_operand("BK", breakpoint_value)
register_machine_operand("BN", lambda c: c.machine.options.serial_number)
register_machine_operand("BV", lambda c: 0)
register_machine_operand("CA", lambda c: int(c.machine.system_letter == "T"))
register_machine_operand("CF", lambda c: ord(c.machine.unsolicited_port))
register_machine_operand("CM", contour_full)
register_machine_operand("CW", lambda c: c.machine.unsolicited_mode)
register_machine_operand("DA", lambda c: ARRAYS - len(c.machine.data.arrays))
register_machine_operand("DL", lambda c: c.machine.model.room.labels - len(c.machine.program.labels))
register_machine_operand("DM", lambda c: c.machine.data.free_elements())
register_machine_operand("DT", lambda c: c.machine.motion.contouring.interval)
register_machine_operand("EA", lambda c: "XYZWN".find(c.machine.motion.cam.master or "?"))
register_machine_operand("EB", lambda c: int(c.machine.motion.cam.enabled))
register_machine_operand("EC", lambda c: c.machine.motion.cam.index)
register_machine_operand("EP", lambda c: c.machine.motion.cam.interval)
register_machine_operand("EO", lambda c: int(c.machine.echo))
register_machine_operand("ES", lambda c: find_system(c).ellipse_terms[0])
register_machine_operand("HW", lambda c: _own_handle(c))
register_machine_operand("WH", lambda c: _own_handle(c))
register_machine_operand("II", lambda c: c.machine.programs.interrupts)
register_machine_operand("LC", lambda c: c.machine.locked)
register_machine_operand("LS", lambda c: _line_count(c))
register_machine_operand("LZ", lambda c: int(c.machine.layout.strip_zeros))
register_machine_operand("MW", lambda c: int(c.machine.modbus_wait))
register_machine_operand("OP", lambda c: c.machine.io.outputs, ("", "0", "X"))
register_machine_operand("RC", lambda c: int(c.machine.recorder.running))
register_machine_operand("RD", lambda c: c.machine.recorder.index)
register_machine_operand("TB", status.general_status)
register_machine_operand("TC", lambda c: c.machine.error_code, ("", "0", "1"))
register_machine_operand("TI", lambda c: c.machine.io.input_byte(), ("", "0", "X"))
register_machine_operand("TM", lambda c: c.machine.timebase.period_us)
register_machine_operand("TR", lambda c: int(c.machine.programs.trace))
register_machine_operand("UL", lambda c: c.machine.model.room.variables - len(c.machine.data.variables))


def _line_count(c: CommandContext) -> int:
    """`_LS`: minus the number of lines while no program runs, otherwise the line to return to (L7108)."""
    return return_line(c) if c.machine.programs.any_running() else -len(c.machine.program.lines)


def return_line(c: CommandContext) -> int:
    """Return the line after the present subroutine, 0 outside (SMC-2000: L1651)."""
    thread = c.thread or c.machine.programs.threads[0]
    return thread.stack[-1].line if thread.stack else 0


def _own_handle(c: CommandContext) -> int:
    return -1 if c.port is None or c.port.name == "S" else HANDLES.index(c.port.name)


@register_operand("PF")
def _compile_position_format(suffix: str) -> Evaluator:
    return lambda c: c.machine.position_format.as_number


@register_operand("VF")
def _compile_variable_format(suffix: str) -> Evaluator:
    return lambda c: c.machine.variable_format.as_number


@register_operand("CN")
def _compile_polarity(suffix: str) -> Evaluator:
    if suffix not in ("", "0", "1", "2", "3"):
        raise CommandError(58)
    index = int(suffix or "0")
    return lambda c: fixed.from_integer(c.machine.polarity[index])


@register_operand("ED")
def _compile_error_place(suffix: str) -> Evaluator:
    if suffix not in ("", "0", "1", "2", "3"):
        raise CommandError(58)

    def read_value(c: CommandContext) -> int:
        programs = c.machine.programs
        error_values = (
            programs.error_line,
            programs.error_thread,
            programs.error_index,
            programs.error_index + 1,
        )
        return fixed.from_integer(error_values[int(suffix or "0")])

    return read_value


def _register_thread_operand(op: str, read: Callable[[CommandContext, int], int]) -> None:
    def compile_thread(suffix: str) -> Evaluator:
        if suffix and (len(suffix) > 1 or suffix not in "01234567"):
            raise CommandError(58)

        def evaluate_thread(c: CommandContext) -> int:
            own = c.thread.number if c.thread is not None else 0
            if int(suffix or "0") >= len(c.machine.programs.threads):
                raise CommandError(58)
            return fixed.from_integer(read(c, int(suffix) if suffix else own))

        return evaluate_thread

    register_operand(op)(compile_thread)


def _current_line(c: CommandContext, number: int) -> int:
    thread = c.machine.programs.threads[number]
    return thread.line if thread.running else -1


def _thread_state(c: CommandContext, number: int) -> int:
    thread = c.machine.programs.threads[number]
    return 0 if not thread.running else 2 if thread.trip is not None and not thread.resting else 1


_register_thread_operand("XQ", _current_line)
_register_thread_operand("HX", _thread_state)
_register_thread_operand("ZS", lambda c, number: len(c.machine.programs.threads[number].stack))


@register_operand("IA")
def _compile_address(suffix: str) -> Evaluator:
    readers: dict[str, Callable[[CommandContext], int]] = {
        "0": lambda c: c.machine.address,
        "1": lambda c: c.machine.retry_time,
        "2": lambda c: len(c.machine.ports.free_handles()),
        "3": _own_handle,
        "4": lambda c: c.machine.ports.lost_handle,
    }
    reader = readers.get(suffix or "0")
    if reader is None:
        raise CommandError(58)
    return lambda c: fixed.from_integer(reader(c))


@register_operand("IH")
def _compile_handle(suffix: str) -> Evaluator:
    if len(suffix) != 2 or suffix[0] not in HANDLES or suffix[1] not in "01234":
        raise CommandError(58)
    name, item = suffix[0], int(suffix[1])

    def read_value(c: CommandContext) -> int:
        port = c.machine.ports.handles.get(name)
        peer = c.machine.ports.outgoing.get(name)
        if item == 4:
            return fixed.from_integer(peer.send_state if peer is not None else 0)
        if port is not None:
            return fixed.from_integer((*port.host, 2 if port.kind == "tcp" else 1, 0)[item])
        if peer is not None:
            return fixed.from_integer((peer.address, peer.number, peer.handle_state, peer.is_unresolved)[item])
        return fixed.from_integer((-1, 0, 0, 0)[item])

    return read_value


@register_operand("SA")
def _compile_response(suffix: str) -> Evaluator:
    if not 1 <= len(suffix) <= 2 or suffix[0] not in HANDLES or (suffix[1:] and suffix[1] not in "01234567"):
        raise CommandError(58)
    name, item = suffix[0], int(suffix[1:] or "0")

    def read_value(c: CommandContext) -> int:
        peer = c.machine.ports.outgoing.get(name)
        fields = peer.fields if peer is not None else []
        return fields[item] if item < len(fields) else fixed.from_integer(UNUSED)

    return read_value
