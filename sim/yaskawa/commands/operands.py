"""Operands `_XX`: reading parameters and status in expressions (L11937-L12206, L15800)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.data import ARRAYS
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands import status
from sim.yaskawa.commands.contour import full
from sim.yaskawa.commands.flow import breakpoint_value
from sim.yaskawa.commands.gear import waiting
from sim.yaskawa.commands.motion import distance
from sim.yaskawa.commands.sequence import OPERAND_READERS, system_of
from sim.yaskawa.commands.system import HANDLES, UNUSED
from sim.yaskawa.language.arguments import LETTERS, canonical
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import Evaluator
from sim.yaskawa.language.parameters import SMC4000
from sim.yaskawa.language.registry import OPERANDS, operand
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.sequence import System
from sim.yaskawa.smc2000.parameters import SMC2000

_SPEED_TO_REGISTER = 1024


def _axis_name(suffix: str) -> str:
    """The axis an operand is about; X when none is given."""
    if not suffix:
        return "X"
    name = suffix if suffix.startswith("~") else canonical(suffix)
    if not name.startswith("~") and name not in LETTERS + "N":
        raise CommandError(58)
    return name


def of_axis(
    op: str,
    read: Callable[[Context, Axis], int],
    *,
    raw: bool = False,
    virtual: bool = False,
    table: dict[str, Callable[[str], Evaluator]] = OPERANDS,
) -> None:
    """Enter an operand of one axis; `raw` when `read` gives units of 1/65536. virtual: axis N has it, too."""

    def compile_axis(suffix: str) -> Evaluator:
        name = _axis_name(suffix)
        factor = 1 if raw else fixed.ONE

        def evaluate(c: Context) -> int:
            axis = c.machine.axis(name)
            if axis.virtual and not virtual:
                raise CommandError(58)
            return read(c, axis) * factor

        return evaluate

    operand(op, table=table)(compile_axis)


def _register(op: str) -> None:
    def read(c: Context, axis: Axis) -> int:
        return axis.registers[op]

    of_axis(op, read, raw=True, virtual=op in SMC4000 and SMC4000[op].virtual)


for _op in SMC4000.keys() | SMC2000.keys():
    if _op not in ("PA", "JG", "PR"):
        _register(_op)


def _absolute_position(c: Context, axis: Axis) -> int:
    """`_PA`: start position while moving, commanded position else (D46)."""
    return axis.move_start if axis.moving else axis.reported(axis.reference(c.machine.now()))


def _begun(c: Context, axis: Axis) -> int:
    return int(axis.moving)


of_axis("PA", _absolute_position, virtual=True)
of_axis("PR", distance, virtual=True)
of_axis("JG", lambda c, axis: abs(axis.registers["JG"]), raw=True, virtual=True)
of_axis("BG", _begun, virtual=True)
of_axis("MO", lambda c, axis: int(axis.motor_off))
of_axis("SC", lambda c, axis: axis.stop_code, virtual=True)
of_axis("TS", status.switches)
of_axis("AL", lambda c, axis: int(axis.latch_armed))
of_axis("TP", status.encoder, virtual=True)
of_axis("DP", status.encoder, virtual=True)
of_axis("IP", status.reference)
of_axis("RP", status.reference, virtual=True)
of_axis("SH", status.reference)
of_axis("TE", status.error)
of_axis("TD", status.auxiliary)
of_axis("DE", lambda c, axis: axis.auxiliary)
of_axis("QP", status.unmodularised)
of_axis("QA", status.auxiliary)
of_axis("RL", status.latched)
of_axis("RU", status.latched)
of_axis("TV", status.velocity)
of_axis("TT", status.volts, raw=True)
of_axis("TY", lambda c, axis: axis.absolute)
of_axis("GM", lambda c, axis: int(axis.gear.gantry))
of_axis("EG", lambda c, axis: int(axis.mode == "cam"))
of_axis("EQ", lambda c, axis: waiting(c, axis.name))
of_axis("LF", lambda c, axis: int(not c.machine.motion.limit_active(axis, True, c.machine.now())))
of_axis("LR", lambda c, axis: int(not c.machine.motion.limit_active(axis, False, c.machine.now())))
of_axis("HM", lambda c, axis: int(status.home_inactive(c, axis)))


def _of_system(op: str, read: Callable[[Context, System], float]) -> None:
    def compile_system(suffix: str) -> Evaluator:
        if suffix not in ("", "S", "T"):
            raise CommandError(58)
        return lambda c: fixed.of(read(c, system_of(c, suffix)))

    operand(op)(compile_system)


def _of_system_register(op: str, read: Callable[[System], float]) -> None:
    _of_system(op, lambda c, system: read(system))


for _op, _read in OPERAND_READERS.items():
    _of_system_register(_op, _read)
_of_system("AV", lambda c, system: system.travelled(c.machine.now()))
_of_system("CS", lambda c, system: _segment(c, system))
_of_system("LM", lambda c, system: system.free(c.machine.now()))
_of_system("LE", lambda c, system: system.length)
_of_system("VE", lambda c, system: system.length)
_of_system("VM", lambda c, system: system.velocity(c.machine.now()) * _SPEED_TO_REGISTER if system.running else 0.0)
_of_system("TN", lambda c, system: _first_tangent(system))


def _segment(c: Context, system: System) -> int:
    contour = c.machine.motion.contour
    if contour is not None and not system.running:
        return contour.count
    return system.index(c.machine.now())


def _first_tangent(system: System) -> float:
    """Position of the tangent axis at the first point (L10790)."""
    if not system.segments:
        return 0.0
    return system.tangent_zero + system.tangent_scale * system.segments[0].heading(0.0)


@operand("VP")
def _vector_position(suffix: str) -> Evaluator:
    name = _axis_name(suffix)

    def read(c: Context) -> int:
        axis = c.machine.axis(name).name
        for system in c.machine.motion.systems.values():
            if axis in system.axes:
                index = system.axes.index(axis)
                return fixed.of(system.intersection(c.machine.now())[index])
        return 0

    return read


def of_machine(
    op: str,
    read: Callable[[Context], int],
    suffixes: tuple[str, ...] = ("",),
    table: dict[str, Callable[[str], Evaluator]] = OPERANDS,
) -> None:
    """Enter an operand of the whole controller."""

    def compile_plain(suffix: str) -> Evaluator:
        if suffix not in suffixes:
            raise CommandError(58)
        return lambda c: fixed.whole(read(c))

    operand(op, table=table)(compile_plain)


of_machine("AB", lambda c: int(not c.machine.motion.abort_input))
of_machine("AE", lambda c: c.machine.last_encoder, ("", *LETTERS[:4], *"ABCD"))
of_machine("BK", breakpoint_value)
of_machine("BN", lambda c: c.machine.options.serial_number)
of_machine("BV", lambda c: 0)
of_machine("CA", lambda c: int(c.machine.system_letter == "T"))
of_machine("CF", lambda c: ord(c.machine.unsolicited_port))
of_machine("CM", full)
of_machine("CW", lambda c: c.machine.unsolicited_mode)
of_machine("DA", lambda c: ARRAYS - len(c.machine.data.arrays))
of_machine("DL", lambda c: c.machine.model.room.labels - len(c.machine.program.labels))
of_machine("DM", lambda c: c.machine.data.free_elements())
of_machine("DT", lambda c: c.machine.motion.contour_interval)
of_machine("EA", lambda c: "XYZWN".find(c.machine.motion.cam.master or "?"))
of_machine("EB", lambda c: int(c.machine.motion.cam.enabled))
of_machine("EC", lambda c: c.machine.motion.cam.index)
of_machine("EP", lambda c: c.machine.motion.cam.interval)
of_machine("EO", lambda c: int(c.machine.echo))
of_machine("ES", lambda c: system_of(c).ellipse_terms[0])
of_machine("HW", lambda c: _own_handle(c))
of_machine("WH", lambda c: _own_handle(c))
of_machine("II", lambda c: c.machine.interpreter.interrupts)
of_machine("LC", lambda c: c.machine.locked)
of_machine("LS", lambda c: _line_count(c))
of_machine("LZ", lambda c: int(c.machine.layout.strip_zeros))
of_machine("MW", lambda c: int(c.machine.modbus_wait))
of_machine("OP", lambda c: c.machine.io.outputs, ("", "0", "X"))
of_machine("RC", lambda c: int(c.machine.recorder.running))
of_machine("RD", lambda c: c.machine.recorder.index)
of_machine("TB", status.general)
of_machine("TC", lambda c: c.machine.error_code, ("", "0", "1"))
of_machine("TI", lambda c: c.machine.io.input_byte(), ("", "0", "X"))
of_machine("TM", lambda c: c.machine.timebase.period_us)
of_machine("TR", lambda c: int(c.machine.interpreter.trace))
of_machine("UL", lambda c: c.machine.model.room.variables - len(c.machine.data.variables))


def _line_count(c: Context) -> int:
    """`_LS`: minus the number of lines while no program runs, else the line to return to (L7108)."""
    return return_line(c) if c.machine.interpreter.any_running() else -len(c.machine.program.lines)


def return_line(c: Context) -> int:
    """The line after the present subroutine, 0 outside (SMC-2000: L1651)."""
    thread = c.thread or c.machine.interpreter.threads[0]
    return thread.stack[-1].line if thread.stack else 0


def _own_handle(c: Context) -> int:
    return -1 if c.port is None or c.port.name == "S" else HANDLES.index(c.port.name)


@operand("PF")
def _position_format(suffix: str) -> Evaluator:
    return lambda c: c.machine.position_format.value


@operand("VF")
def _variable_format(suffix: str) -> Evaluator:
    return lambda c: c.machine.variable_format.value


@operand("CN")
def _polarity(suffix: str) -> Evaluator:
    if suffix not in ("", "0", "1", "2", "3"):
        raise CommandError(58)
    index = int(suffix or "0")
    return lambda c: fixed.whole(c.machine.polarity[index])


@operand("ED")
def _error_place(suffix: str) -> Evaluator:
    if suffix not in ("", "0", "1", "2", "3"):
        raise CommandError(58)

    def read(c: Context) -> int:
        interpreter = c.machine.interpreter
        place = (
            interpreter.error_line,
            interpreter.error_thread,
            interpreter.error_index,
            interpreter.error_index + 1,
        )
        return fixed.whole(place[int(suffix or "0")])

    return read


def _of_thread(op: str, read: Callable[[Context, int], int]) -> None:
    def compile_thread(suffix: str) -> Evaluator:
        if suffix and (len(suffix) > 1 or suffix not in "01234567"):
            raise CommandError(58)

        def run(c: Context) -> int:
            own = c.thread.number if c.thread is not None else 0
            if int(suffix or "0") >= len(c.machine.interpreter.threads):
                raise CommandError(58)
            return fixed.whole(read(c, int(suffix) if suffix else own))

        return run

    operand(op)(compile_thread)


def _current_line(c: Context, number: int) -> int:
    thread = c.machine.interpreter.threads[number]
    return thread.line if thread.running else -1


def _thread_state(c: Context, number: int) -> int:
    thread = c.machine.interpreter.threads[number]
    return 0 if not thread.running else 2 if thread.trip is not None and not thread.resting else 1


_of_thread("XQ", _current_line)
_of_thread("HX", _thread_state)
_of_thread("ZS", lambda c, number: len(c.machine.interpreter.threads[number].stack))


@operand("IA")
def _address(suffix: str) -> Evaluator:
    readers: dict[str, Callable[[Context], int]] = {
        "0": lambda c: c.machine.address,
        "1": lambda c: c.machine.retry_time,
        "2": lambda c: len(c.machine.ports.free_handles()),
        "3": _own_handle,
        "4": lambda c: c.machine.ports.lost_handle,
    }
    reader = readers.get(suffix or "0")
    if reader is None:
        raise CommandError(58)
    return lambda c: fixed.whole(reader(c))


@operand("IH")
def _handle(suffix: str) -> Evaluator:
    if len(suffix) != 2 or suffix[0] not in HANDLES or suffix[1] not in "01234":
        raise CommandError(58)
    name, item = suffix[0], int(suffix[1])

    def read(c: Context) -> int:
        port = c.machine.ports.handles.get(name)
        peer = c.machine.ports.outgoing.get(name)
        if item == 4:
            return fixed.whole(peer.asked if peer is not None else 0)
        if port is not None:
            return fixed.whole((0, 0, 2 if port.kind == "tcp" else 1, 0)[item])
        if peer is not None:
            return fixed.whole((peer.address, peer.number, peer.state, peer.unresolved)[item])
        return fixed.whole((-1, 0, 0, 0)[item])

    return read


@operand("SA")
def _response(suffix: str) -> Evaluator:
    if not 1 <= len(suffix) <= 2 or suffix[0] not in HANDLES or (suffix[1:] and suffix[1] not in "01234567"):
        raise CommandError(58)
    name, item = suffix[0], int(suffix[1:] or "0")

    def read(c: Context) -> int:
        peer = c.machine.ports.outgoing.get(name)
        found = peer.fields if peer is not None else []
        return found[item] if item < len(found) else fixed.whole(UNUSED)

    return read
