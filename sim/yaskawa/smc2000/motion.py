"""Motion commands that the SMC-2000 has otherwise: targets, VM, AD, MC, AL, CN, absolute encoders (L6754-L12820)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import Format
from sim.yaskawa.commands.motion import chosen, distance, flag_query, increment
from sim.yaskawa.commands.parameters import arm, form_command, parameter_writer
from sim.yaskawa.commands.sequence import tangent, vector_mode
from sim.yaskawa.commands.status import encoder, error, tell, volts
from sim.yaskawa.commands.trip import enter_place, travelled
from sim.yaskawa.language.arguments import LETTERS, parse_axes, parse_fields, values
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.registry import SMC2000_COMMANDS, Outcome, Runner, command
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.trippoints import motion_complete

_INCREMENT = Format(7, 0)
_NO_POSITION = -2147483648
_POLARITIES = 3


def destination(c: Context, axis: Axis) -> int:
    """`PA ?`, `_PA`: where the move goes, at rest where the command stands (L10760)."""
    if axis.mode == "move":
        return fixed.rounded(axis.target)
    return axis.reported(axis.reference(c.machine.now()))


def _show_destination(c: Context, axis: Axis) -> str:
    return c.machine.show_counts(destination(c, axis))


def _show_distance(c: Context, axis: Axis) -> str:
    return c.machine.show_counts(distance(c, axis))


def _show_position(c: Context, axis: Axis) -> str:
    return _INCREMENT.write(fixed.whole(encoder(c, axis)), c.machine.layout)


form_command("PA", _show_destination, parameter_writer("PA", None, arm), SMC2000_COMMANDS)
form_command("PR", _show_distance, parameter_writer("PR", None, arm), SMC2000_COMMANDS)
form_command("IP", _show_position, increment, SMC2000_COMMANDS)


@command("VM", table=SMC2000_COMMANDS)
def _vector_mode(text: str) -> Runner:
    """Commas between the letters are optional; `VM ?` tells the free segments (L12440)."""
    if text == "?":
        return lambda c: c.machine.show("VM", fixed.whole(c.machine.motion.systems["S"].free(c.machine.now())))
    return vector_mode(text.replace(",", ""))


def _after_distance(axis: Axis, c: Context, place: int) -> Outcome:
    return travelled(axis, c, abs(place))


enter_place("AD", _after_distance, _NO_POSITION, SMC2000_COMMANDS)


@command("MC", table=SMC2000_COMMANDS)
def _motion_complete(text: str) -> Runner:
    """Takes S for the axes of the sequence (L10277)."""
    names = parse_axes(text, LETTERS + "S")

    def run(c: Context) -> Outcome:
        motion = c.machine.motion
        axes = [c.machine.axis(name) for name in names if name != "S"] or ([] if names else list(motion.real))
        if "S" in names:
            axes += motion.coordinated.members(motion.systems["S"])
        return motion_complete(axes, c.machine.now())

    return run


@command("AL", table=SMC2000_COMMANDS)
def _arm_latch(text: str) -> Runner:
    if "?" in text:
        return flag_query(text, lambda axis: axis.latch_armed)
    names = parse_axes(text)

    def run(c: Context) -> Outcome:
        for axis in chosen(c, names):
            axis.latch_armed = True
        return None

    return run


@command("CN", table=SMC2000_COMMANDS)
def _configure(text: str) -> Runner:
    """Polarity of limit switches, home switches and latch inputs (L7889)."""
    fields = values(parse_fields(text, _POLARITIES))

    def run(c: Context) -> Outcome:
        given = [None if raw is None else fixed.truncated(raw) for raw in fields(c)]
        if any(value not in (None, 1, -1) for value in given):
            raise CommandError(6)
        for index, value in enumerate(given):
            if value is not None:
                c.machine.polarity[index] = value
        c.machine.motion.homing.polarity = c.machine.polarity[1]
        return None

    return run


@command("TN", table=SMC2000_COMMANDS)
def _tangent(text: str) -> Runner:
    """`TN ?` tells where the tangent axis begins, as `_TN` does (L12030)."""
    if text == "?":
        return lambda c: c.machine.show("TN", c.machine.model.operand("_TN")(c))
    return tangent(text)


tell("TE", error, table=SMC2000_COMMANDS, asked=False)  # L11850
tell("TT", volts, Format(1, 4), table=SMC2000_COMMANDS, asked=False)  # L12179
