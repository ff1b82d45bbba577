"""Trippoints: AD AI AM AP AR AS AT AV MC MF MR WT (L2379-L3063, L7381-L7677, L11795-L11837)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.motion import chosen_axes, resolve_names
from sim.yaskawa.language.arguments import LETTERS, compile_values, parse_axes, parse_fields, parse_form
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.expressions import compile_integer
from sim.yaskawa.language.registry import COMMANDS, CommandDefinition, Outcome, Runner, register_command
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.trippoints import at_sample, at_speed, motion_complete, path_reached, place_reached, when_passed


@register_command("WT")
def _compile_wait(text: str) -> Runner:
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        samples = value(c)
        if samples < 0:
            raise CommandError(6)
        return at_sample(c.machine.current_sample() + samples)

    return run_command


@register_command("AT")
def _compile_after_time(text: str) -> Runner:
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        machine = c.machine
        owner = c.thread or machine.programs.threads[0]
        samples = value(c)
        if samples == 0:
            owner.reference = machine.current_sample()
            return None
        due = owner.reference + abs(samples)
        if samples < 0:
            owner.reference = due
        return at_sample(due)

    return run_command


@register_command("AI")
def _compile_after_input(text: str) -> Runner:
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        number = value(c)
        if not 1 <= abs(number) <= len(c.machine.environment.inputs):
            raise CommandError(6)
        return when_passed(lambda machine, sample: machine.environment.inputs[abs(number) - 1] == (number > 0))

    return run_command


@register_command("AM")
def _compile_after_move(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "ST")

    def run_command(c: CommandContext) -> Outcome:
        motion = c.machine.motion
        wanted_names = resolve_names(c, names)
        systems = [motion.systems[name] for name in wanted_names if name in motion.systems]
        axes = [c.machine.find_axis(name) for name in wanted_names if name not in motion.systems]
        if not names:
            axes, systems = list(motion.real), list(motion.systems.values())
        return when_passed(
            lambda machine, sample: (
                not any(axis.is_moving for axis in axes) and not any(system.running for system in systems)
            )
        )

    return run_command


@register_command("AS")
def _compile_after_speed(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "ST")

    def run_command(c: CommandContext) -> Outcome:
        motion = c.machine.motion
        wanted_names = resolve_names(c, names)
        systems = [motion.systems[name] for name in wanted_names if name in motion.systems]
        axes = [c.machine.find_axis(name) for name in wanted_names if name not in motion.systems]
        return at_speed(axes if names else list(motion.real), systems)

    return run_command


@register_command("MC")
def _compile_motion_complete(text: str) -> Runner:
    names = parse_axes(text)
    return lambda c: motion_complete(chosen_axes(c, names), c.machine.current_sample())


@register_command("AV")
def _compile_after_vector(text: str) -> Runner:
    fields = compile_values(parse_fields(text, 2))

    def run_command(c: CommandContext) -> Outcome:
        for name, raw in zip(c.machine.model.figures.systems, fields(c), strict=False):
            if raw is not None:
                if raw < 0:
                    raise CommandError(6)
                system = c.machine.motion.systems[name]
                base = 0.0 if c.machine.options.av_absolute else system.mark
                return path_reached(system, base + raw / fixed.ONE)
        raise CommandError(50)

    return run_command


def register_place_trip(
    op: str,
    go: Callable[[ServoAxis, CommandContext, int], Outcome],
    low: int,
    table: dict[str, CommandDefinition] = COMMANDS,
) -> None:
    """Register a trip-point at a position of one axis; `low` is the smallest one allowed."""

    def compile_place(text: str) -> Runner:
        form = parse_form(text)
        if len(form) != 1:
            raise CommandError(50 if not form else 4)
        name, field = form[0]
        if field is None or isinstance(field, str):
            raise CommandError(51)

        def run_command(c: CommandContext) -> Outcome:
            position = fixed.to_integer(field(c))
            if position < low:
                raise CommandError(6)
            return go(c.machine.find_axis(name), c, position)

        return run_command

    register_command(op, table=table)(compile_place)


def _trip_absolute(axis: ServoAxis, c: CommandContext, place: int) -> Outcome:
    if not axis.is_moving and not axis.gear.is_engaged and axis.mode != "cam":
        return None
    return place_reached(axis, place, upward=place >= axis.reference_at(c.machine.current_sample()), commanded=True)


def _motion_direction(axis: ServoAxis, now: int) -> int:
    velocity = axis.command_velocity(now + 1)
    return -1 if velocity < 0 or (velocity == 0 and axis.mode == "move" and axis.target < axis.command_at(now)) else 1


def trip_travelled(axis: ServoAxis, c: CommandContext, place: int) -> Outcome:
    """`AD`: a distance from the start of the move."""
    if not axis.is_moving:
        return None
    sign = _motion_direction(axis, c.machine.current_sample())
    goal = axis.move_start + sign * place
    axis.mark = goal
    return place_reached(axis, goal, upward=sign > 0, commanded=True)


def _trip_relative(axis: ServoAxis, c: CommandContext, place: int) -> Outcome:
    if not axis.is_moving:
        return None
    sign = _motion_direction(axis, c.machine.current_sample())
    goal = fixed.round_half_up(axis.mark) + sign * place
    axis.mark = goal
    return place_reached(axis, goal, upward=sign > 0, commanded=True)


def _trip_forward(axis: ServoAxis, c: CommandContext, place: int) -> Outcome:
    return place_reached(axis, place, upward=True, commanded=False)


def _trip_reverse(axis: ServoAxis, c: CommandContext, place: int) -> Outcome:
    return place_reached(axis, place, upward=False, commanded=False)


_LEAST = -2147483648
register_place_trip("AD", trip_travelled, 0)
register_place_trip("AR", _trip_relative, 0)
register_place_trip("AP", _trip_absolute, _LEAST)
register_place_trip("MF", _trip_forward, _LEAST)
register_place_trip("MR", _trip_reverse, _LEAST)
