"""Motion commands that the SMC-2000 has otherwise: targets, VM, AD, MC, AL, CN, absolute encoders (L6754-L12820)."""

from sim.yaskawa import fixed
from sim.yaskawa.arguments import LETTERS, parse_axes, parse_fields, parse_form, split, values
from sim.yaskawa.axis import Axis
from sim.yaskawa.commands_motion import busy, chosen, increment
from sim.yaskawa.commands_parameters import arm, form_command, parameter_writer, targets
from sim.yaskawa.commands_sequence import tangent, vector_mode
from sim.yaskawa.commands_status import encoder, error, tell, volts
from sim.yaskawa.commands_trip import enter_place, travelled
from sim.yaskawa.context import Context
from sim.yaskawa.errors import CommandError
from sim.yaskawa.formats import Format
from sim.yaskawa.registry import SMC2000_COMMANDS, Outcome, Runner, bare, command
from sim.yaskawa.trippoints import motion_complete

_INCREMENT = Format(7, 0)
_NO_POSITION = -2147483648
_POLARITIES = 3


def destination(c: Context, axis: Axis) -> int:
    """`PA ?`, `_PA`: where the move goes, at rest where the command stands (L10760)."""
    if axis.mode == "move":
        return fixed.rounded(axis.target)
    return axis.reported(axis.reference(c.machine.now()))


def distance(c: Context, axis: Axis) -> int:
    """`PR ?`, `_PR`: the incremental distance, also when PA has set it (L10845)."""
    if axis.mode == "move":
        return fixed.rounded(axis.target) - axis.move_start
    if axis.armed == "PA":
        return fixed.truncated(axis.registers["PA"]) - axis.reference(c.machine.now())
    return fixed.truncated(axis.registers["PR"])


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
        asked = [LETTERS[index] for index, mark in enumerate(split(text)) if mark == "?"]
        return lambda c: ",".join(c.machine.show_whole(int(c.machine.axis(name).latch_armed), 1) for name in asked)
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
tell("TY", lambda c, axis: axis.absolute, Format(10, 0), table=SMC2000_COMMANDS)  # L12250


# Absolute encoders


@command("AE", table=SMC2000_COMMANDS)
def _absolute_encoder(text: str) -> Runner:
    """The encoder's position becomes the axis' (L6959); the argument is its resolution."""
    form = parse_form(text)

    def run(c: Context) -> Outcome:
        given: list[tuple[Axis, int]] = []
        for name, field in form:
            if field is None or isinstance(field, str):
                raise CommandError(51)
            resolution = fixed.truncated(field(c))
            if not 1 <= abs(resolution) <= 100_000:
                raise CommandError(6)
            given += [(axis, resolution) for axis in targets(c, name)]
        if not given:
            raise CommandError(50)
        for axis, resolution in given:
            _read_encoder(c, axis, resolution)
        return None

    return run


def _read_encoder(c: Context, axis: Axis, resolution: int) -> None:
    encoders = c.machine.options.encoders
    if not encoders:
        raise CommandError(114)
    if axis.moving:
        raise busy(axis)
    if not axis.motor_off:
        raise CommandError(115)
    c.machine.last_encoder = axis.index
    place = encoders.get(axis.name)
    if place is None:
        raise CommandError(117)
    axis.absolute = place if resolution > 0 else -place
    axis.turns = axis.absolute // abs(resolution)
    axis.define(c.machine.now(), axis.absolute)


@command("QY", table=SMC2000_COMMANDS)
def _encoder_text(text: str) -> Runner:
    """What the encoder read last has sent: its revolutions (L11003)."""
    bare(text.removeprefix("?"))

    def run(c: Context) -> Outcome:
        if not c.machine.options.encoders:
            raise CommandError(114)
        return f"P{c.machine.motion.real[c.machine.last_encoder].turns:+06d}"

    return run
