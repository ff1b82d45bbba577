"""Commands that set and report parameters of axes, from the table in `parameters`."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language import parameters, smc2000_parameters
from sim.yaskawa.language.arguments import Field, parse_form
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.parameters import AxisParameter
from sim.yaskawa.language.registry import COMMANDS, CommandDefinition, Outcome, Runner
from sim.yaskawa.motion.axis import ServoAxis

Applied = Callable[[CommandContext, ServoAxis, str], None]
Checked = Callable[[CommandContext, ServoAxis, str, int], None]
Writer = Callable[[CommandContext, list[tuple[ServoAxis, int]]], None]


def target_axes(c: CommandContext, name: str) -> list[ServoAxis]:
    """Return the axes that one entry of a form applies to."""
    return list(c.machine.motion.real) if name == "*" else [c.machine.find_axis(name)]


def register_form(
    op: str,
    read: Callable[[CommandContext, ServoAxis], str],
    write: Writer,
    table: dict[str, CommandDefinition] = COMMANDS,
) -> None:
    """Register a command in the four forms with interrogation: `read` answers `?`, `write` sets."""

    def compile_form(text: str) -> Runner:
        if not text:
            raise CommandError(50)
        entries: list[tuple[str, Field]] = parse_form(text)
        if any(isinstance(field, str) for _, field in entries):
            if not all(isinstance(field, str) for _, field in entries):
                raise CommandError(51)
            return lambda c: ",".join(read(c, axis) for name, _ in entries for axis in target_axes(c, name))

        def run_command(c: CommandContext) -> Outcome:
            raw_values: list[tuple[ServoAxis, int]] = []
            for name, field in entries:
                if field is None or isinstance(field, str):
                    raise CommandError(50)
                raw = field(c)
                raw_values += [(axis, raw) for axis in target_axes(c, name)]
            write(c, raw_values)
            return None

        return run_command

    table[op] = CommandDefinition(compile_form)


def register_parameter(op: str, check: Checked | None = None, applied: Applied | None = None) -> None:
    """Register the command of a parameter in the table."""

    def read_value(c: CommandContext, axis: ServoAxis) -> str:
        parameter = c.machine.model.parameters[op]
        if not parameter.asked or op in c.machine.model.unasked:
            raise CommandError(51)
        layout = parameter.format or c.machine.position_format
        return layout.format_value(axis.registers[op], c.machine.layout)

    register_form(op, read_value, parameter_writer(op, check, applied))


def parameter_writer(op: str, check: Checked | None = None, applied: Applied | None = None) -> Writer:
    """Make the function that sets a parameter of the table."""

    def write_values(c: CommandContext, given: list[tuple[ServoAxis, int]]) -> None:
        parameter = c.machine.model.parameters[op]
        new_values = [(axis, accept_value(parameter, axis, raw)) for axis, raw in given]
        for axis, raw in new_values:
            if axis.is_moving and not parameter.moving:
                raise CommandError(18 if axis.mode == "contour" else 29 if axis.mode == "sequence" else 7)
            if check is not None:
                check(c, axis, op, raw)
        for axis, raw in new_values:
            axis.registers[op] = raw
            if applied is not None:
                applied(c, axis, op)

    return write_values


def accept_value(parameter: AxisParameter, axis: ServoAxis, raw: int) -> int:
    """Return the stored value; 6 when out of range, 4 when the virtual axis has no such parameter."""
    if axis.virtual and not parameter.virtual:
        raise CommandError(4)
    value = parameter.accept_value(raw)
    if value is None:
        raise CommandError(6)
    return value


def _replan_axis(c: CommandContext, axis: ServoAxis, op: str) -> None:
    machine = c.machine
    if axis.is_moving and axis.profile is not None:
        machine.motion.plan_profile(axis, machine.timebase.next_sample())


def _reschedule_axis(c: CommandContext, axis: ServoAxis, op: str) -> None:
    machine = c.machine
    if axis.is_moving and axis.profile is not None:
        machine.motion.schedule_axis(axis, machine.timebase.next_sample())


def _check_deceleration(c: CommandContext, axis: ServoAxis, op: str, raw: int) -> None:
    if axis.is_moving and axis.mode != "jog" and not axis.stopping:
        raise CommandError(7)


def _check_jog(c: CommandContext, axis: ServoAxis, op: str, raw: int) -> None:
    if axis.is_moving and axis.mode != "jog":
        raise CommandError({"contour": 18, "sequence": 29}.get(axis.mode, 13))


def arm_axis(c: CommandContext, axis: ServoAxis, op: str) -> None:
    axis.armed = op


def _apply_jog(c: CommandContext, axis: ServoAxis, op: str) -> None:
    axis.armed = "JG"
    if axis.mode == "jog" and not axis.stopping:
        _replan_axis(c, axis, op)


def _gear_ratio(c: CommandContext, axis: ServoAxis, op: str) -> None:
    at = c.machine.timebase.next_sample()
    c.machine.motion.set_gear_ratio(axis, axis.registers["GR"] / fixed.ONE, at)


def _check_motor_type(c: CommandContext, axis: ServoAxis, op: str, raw: int) -> None:
    if abs(raw) not in (fixed.ONE, 2 * fixed.ONE, 5 * fixed.ONE // 2):
        raise CommandError(6)
    if abs(raw) > fixed.ONE and not c.machine.options.can_step:
        raise CommandError(96)


def _check_stepper(c: CommandContext, axis: ServoAxis, op: str, raw: int) -> None:
    fastest = c.machine.model.figures.stepper_fastest
    if fastest and axis.is_stepper and abs(raw) > fastest * fixed.ONE:
        raise CommandError(6)


def _check_ratio(c: CommandContext, axis: ServoAxis, op: str, raw: int) -> None:
    if raw and c.machine.gear_master in (axis.name, f"C{axis.name}"):
        raise CommandError(46)


def _check_filter(c: CommandContext, axis: ServoAxis, op: str, raw: int) -> None:
    if raw > 1_000_000 * fixed.ONE // (4 * c.machine.timebase.period_us):
        raise CommandError(6)


def _check_cycle(c: CommandContext, axis: ServoAxis, op: str, raw: int) -> None:
    if axis.name == c.machine.motion.cam.master and abs(raw) > 8388607 * fixed.ONE:
        raise CommandError(6)


def _apply_cycle(c: CommandContext, axis: ServoAxis, op: str) -> None:
    axis.registers[op] = abs(axis.registers[op])
    c.machine.motion.cam.cycles[axis.name] = fixed.to_integer(axis.registers[op])


def _apply_pole(c: CommandContext, axis: ServoAxis, op: str) -> None:
    axis.registers[op] = _POLES.get(axis.registers[op], axis.registers[op])


_POLES = {
    fixed.parse_literal(literal): fixed.parse_literal(pole) for literal, pole in ((".95", ".95271"), (".9", ".89971"))
}
"""PL stores a coarser value than it receives, by a rule that the manual does not state; it shows these two
(L8378-L8387)."""

_SPECIAL: dict[str, tuple[Checked | None, Applied | None]] = {
    "AC": (None, _replan_axis),
    "SP": (_check_stepper, _replan_axis),
    "DC": (_check_deceleration, _replan_axis),
    "JG": (_check_jog, _apply_jog),
    "PR": (None, arm_axis),
    "PA": (None, arm_axis),
    "GR": (_check_ratio, _gear_ratio),
    "MT": (_check_motor_type, None),
    "FL": (None, _reschedule_axis),
    "BL": (None, _reschedule_axis),
    "NF": (_check_filter, None),
    "NB": (_check_filter, None),
    "NZ": (_check_filter, None),
    "EM": (_check_cycle, _apply_cycle),
    "PL": (None, _apply_pole),
}

for _name in parameters.SMC4000.keys() | smc2000_parameters.SMC2000.keys():
    register_parameter(_name, *_SPECIAL.get(_name, (None, None)))
