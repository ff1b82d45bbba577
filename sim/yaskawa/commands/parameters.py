"""Commands that set and tell parameters of axes, from the table in `parameters`."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language import parameters
from sim.yaskawa.language.arguments import Field, parse_form
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.parameters import Parameter
from sim.yaskawa.language.registry import COMMANDS, Command, Outcome, Runner
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.smc2000 import parameters as smc2000_parameters

Applied = Callable[[Context, Axis, str], None]
Checked = Callable[[Context, Axis, str, int], None]
Writer = Callable[[Context, list[tuple[Axis, int]]], None]


def targets(c: Context, name: str) -> list[Axis]:
    """The axes that one entry of a form is for."""
    return list(c.machine.motion.real) if name == "*" else [c.machine.axis(name)]


def form_command(
    op: str,
    read: Callable[[Context, Axis], str],
    write: Writer,
    table: dict[str, Command] = COMMANDS,
) -> None:
    """Enter a command in the four forms with interrogation: `read` answers `?`, `write` sets."""

    def compile_form(text: str) -> Runner:
        if not text:
            raise CommandError(50)
        entries: list[tuple[str, Field]] = parse_form(text)
        if any(isinstance(field, str) for _, field in entries):
            if not all(isinstance(field, str) for _, field in entries):
                raise CommandError(51)
            return lambda c: ",".join(read(c, axis) for name, _ in entries for axis in targets(c, name))

        def run(c: Context) -> Outcome:
            given: list[tuple[Axis, int]] = []
            for name, field in entries:
                if field is None or isinstance(field, str):
                    raise CommandError(50)
                raw = field(c)
                given += [(axis, raw) for axis in targets(c, name)]
            write(c, given)
            return None

        return run

    table[op] = Command(compile_form)


def enter_parameter(op: str, check: Checked | None = None, applied: Applied | None = None) -> None:
    """Enter the command of a parameter in the table."""

    def read(c: Context, axis: Axis) -> str:
        parameter = c.machine.model.parameters[op]
        if not parameter.asked or op in c.machine.model.unasked:
            raise CommandError(51)
        layout = parameter.format or c.machine.position_format
        return layout.write(axis.registers[op], c.machine.layout)

    form_command(op, read, parameter_writer(op, check, applied))


def parameter_writer(op: str, check: Checked | None = None, applied: Applied | None = None) -> Writer:
    """What sets a parameter of the table."""

    def write(c: Context, given: list[tuple[Axis, int]]) -> None:
        parameter = c.machine.model.parameters[op]
        accepted = [(axis, accept(parameter, axis, raw)) for axis, raw in given]
        for axis, raw in accepted:
            if axis.moving and not parameter.moving:
                raise CommandError(18 if axis.mode == "contour" else 29 if axis.mode == "sequence" else 7)
            if check is not None:
                check(c, axis, op, raw)
        for axis, raw in accepted:
            axis.registers[op] = raw
            if applied is not None:
                applied(c, axis, op)

    return write


def accept(parameter: Parameter, axis: Axis, raw: int) -> int:
    """The value kept; 6 when out of range, 4 when the virtual axis has no such parameter."""
    if axis.virtual and not parameter.virtual:
        raise CommandError(4)
    kept = parameter.accept(raw)
    if kept is None:
        raise CommandError(6)
    return kept


def _replan(c: Context, axis: Axis, op: str) -> None:
    machine = c.machine
    if axis.moving and axis.profile is not None:
        machine.motion.plan(axis, machine.timebase.next_sample())


def _reschedule(c: Context, axis: Axis, op: str) -> None:
    machine = c.machine
    if axis.moving and axis.profile is not None:
        machine.motion.schedule(axis, machine.timebase.next_sample())


def _check_deceleration(c: Context, axis: Axis, op: str, raw: int) -> None:
    if axis.moving and axis.mode != "jog" and not axis.stopping:
        raise CommandError(7)


def _check_jog(c: Context, axis: Axis, op: str, raw: int) -> None:
    if axis.moving and axis.mode != "jog":
        raise CommandError({"contour": 18, "sequence": 29}.get(axis.mode, 13))


def arm(c: Context, axis: Axis, op: str) -> None:
    axis.armed = op


def _jog(c: Context, axis: Axis, op: str) -> None:
    axis.armed = "JG"
    if axis.mode == "jog" and not axis.stopping:
        _replan(c, axis, op)


def _gear_ratio(c: Context, axis: Axis, op: str) -> None:
    at = c.machine.timebase.next_sample()
    c.machine.motion.set_gear_ratio(axis, axis.registers["GR"] / fixed.ONE, at)


def _check_motor_type(c: Context, axis: Axis, op: str, raw: int) -> None:
    if abs(raw) not in (fixed.ONE, 2 * fixed.ONE, 5 * fixed.ONE // 2):
        raise CommandError(6)
    if abs(raw) > fixed.ONE and not c.machine.options.can_step:
        raise CommandError(96)


def _check_stepper(c: Context, axis: Axis, op: str, raw: int) -> None:
    fastest = c.machine.model.figures.stepper_fastest
    if fastest and axis.stepper and abs(raw) > fastest * fixed.ONE:
        raise CommandError(6)


def _check_ratio(c: Context, axis: Axis, op: str, raw: int) -> None:
    if raw and c.machine.gear_master in (axis.name, f"C{axis.name}"):
        raise CommandError(46)


def _check_filter(c: Context, axis: Axis, op: str, raw: int) -> None:
    if raw > 1_000_000 * fixed.ONE // (4 * c.machine.timebase.period_us):
        raise CommandError(6)


def _check_cycle(c: Context, axis: Axis, op: str, raw: int) -> None:
    if axis.name == c.machine.motion.cam.master and abs(raw) > 8388607 * fixed.ONE:
        raise CommandError(6)


def _cycle(c: Context, axis: Axis, op: str) -> None:
    axis.registers[op] = abs(axis.registers[op])
    c.machine.motion.cam.cycles[axis.name] = fixed.truncated(axis.registers[op])


def _pole(c: Context, axis: Axis, op: str) -> None:
    axis.registers[op] = _POLES.get(axis.registers[op], axis.registers[op])


_POLES = {fixed.literal(given): fixed.literal(kept) for given, kept in ((".95", ".95271"), (".9", ".89971"))}
"""What PL keeps is coarser than what it is given, by a rule that is not told; these two are shown (L8378-L8387)."""

_SPECIAL: dict[str, tuple[Checked | None, Applied | None]] = {
    "AC": (None, _replan),
    "SP": (_check_stepper, _replan),
    "DC": (_check_deceleration, _replan),
    "JG": (_check_jog, _jog),
    "PR": (None, arm),
    "PA": (None, arm),
    "GR": (_check_ratio, _gear_ratio),
    "MT": (_check_motor_type, None),
    "FL": (None, _reschedule),
    "BL": (None, _reschedule),
    "NF": (_check_filter, None),
    "NB": (_check_filter, None),
    "NZ": (_check_filter, None),
    "EM": (_check_cycle, _cycle),
    "PL": (None, _pole),
}

for _name in parameters.SMC4000.keys() | smc2000_parameters.SMC2000.keys():
    enter_parameter(_name, *_SPECIAL.get(_name, (None, None)))
