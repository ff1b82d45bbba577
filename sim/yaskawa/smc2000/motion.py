"""Motion commands that differ in the SMC-2000: targets, VM, AD, MC, AL, CN, absolute encoders (L6754-L12820)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import NumberFormat
from sim.yaskawa.commands.motion import chosen_axes, compile_flag_query, increment_target, move_distance
from sim.yaskawa.commands.parameters import arm_axis, parameter_writer, register_form
from sim.yaskawa.commands.sequence import compile_tangent, compile_vector_mode
from sim.yaskawa.commands.status import ReportForm, encoder_position, position_error, register_report, torque_volts
from sim.yaskawa.commands.trip import register_place_trip, trip_travelled
from sim.yaskawa.language.arguments import LETTERS, compile_values, parse_axes, parse_fields
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.registry import SMC2000_COMMANDS, Outcome, Runner, register_command
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.trippoints import motion_complete

_INCREMENT = NumberFormat(7, 0)
_NO_POSITION = -2147483648
_POLARITIES = 3


def move_destination(c: CommandContext, axis: ServoAxis) -> int:
    """`PA ?`, `_PA`: the target of the move, at rest the commanded position (L10760)."""
    if axis.mode == "move":
        return fixed.round_half_up(axis.target)
    return axis.report_counts(axis.reference_at(c.machine.current_sample()))


def _show_destination(c: CommandContext, axis: ServoAxis) -> str:
    return c.machine.format_counts(move_destination(c, axis))


def _show_distance(c: CommandContext, axis: ServoAxis) -> str:
    return c.machine.format_counts(move_distance(c, axis))


def _show_position(c: CommandContext, axis: ServoAxis) -> str:
    return _INCREMENT.format_value(fixed.from_integer(encoder_position(c, axis)), c.machine.layout)


register_form("PA", _show_destination, parameter_writer("PA", None, arm_axis), SMC2000_COMMANDS)
register_form("PR", _show_distance, parameter_writer("PR", None, arm_axis), SMC2000_COMMANDS)
register_form("IP", _show_position, increment_target, SMC2000_COMMANDS)


@register_command("VM", table=SMC2000_COMMANDS)
def _compile_vector_mode(text: str) -> Runner:
    """Commas between the letters are optional; `VM ?` reports the free segments (L12440)."""
    if text == "?":
        return lambda c: c.machine.format_answer(
            "VM", fixed.from_integer(c.machine.motion.systems["S"].free_entries(c.machine.current_sample()))
        )
    return compile_vector_mode(text.replace(",", ""))


def _after_distance(axis: ServoAxis, c: CommandContext, place: int) -> Outcome:
    return trip_travelled(axis, c, abs(place))


register_place_trip("AD", _after_distance, _NO_POSITION, SMC2000_COMMANDS)


@register_command("MC", table=SMC2000_COMMANDS)
def _compile_motion_complete(text: str) -> Runner:
    """MC: accepts S for the axes of the sequence (L10277)."""
    names = parse_axes(text, LETTERS + "S")

    def run_command(c: CommandContext) -> Outcome:
        motion = c.machine.motion
        axes = [c.machine.find_axis(name) for name in names if name != "S"] or ([] if names else list(motion.real))
        if "S" in names:
            axes += motion.coordinated.member_axes(motion.systems["S"])
        return motion_complete(axes, c.machine.current_sample())

    return run_command


@register_command("AL", table=SMC2000_COMMANDS)
def _compile_arm_latch(text: str) -> Runner:
    if "?" in text:
        return compile_flag_query(text, lambda axis: axis.latch_armed)
    names = parse_axes(text)

    def run_command(c: CommandContext) -> Outcome:
        for axis in chosen_axes(c, names):
            axis.latch_armed = True
        return None

    return run_command


@register_command("CN", table=SMC2000_COMMANDS)
def _compile_configure(text: str) -> Runner:
    """Set the polarity of limit switches, home switches and latch inputs (L7889)."""
    fields = compile_values(parse_fields(text, _POLARITIES))

    def run_command(c: CommandContext) -> Outcome:
        values = [None if raw is None else fixed.to_integer(raw) for raw in fields(c)]
        if any(value not in (None, 1, -1) for value in values):
            raise CommandError(6)
        for index, value in enumerate(values):
            if value is not None:
                c.machine.polarity[index] = value
        c.machine.motion.homing.polarity = c.machine.polarity[1]
        return None

    return run_command


@register_command("TN", table=SMC2000_COMMANDS)
def _compile_tangent(text: str) -> Runner:
    """`TN ?` reports the start of the tangent axis, as `_TN` does (L12030)."""
    if text == "?":
        return lambda c: c.machine.format_answer("TN", c.machine.compile_operand("_TN")(c))
    return compile_tangent(text)


register_report("TE", position_error, ReportForm(queryable=False), SMC2000_COMMANDS)  # L11850
register_report("TT", torque_volts, ReportForm(NumberFormat(1, 4), queryable=False), SMC2000_COMMANDS)  # L12179
