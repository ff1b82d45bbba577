"""Trippoints: AD AI AM AP AR AS AT AV MC MF MR WT (L2379-L3063, L7381-L7677, L11795-L11837)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.motion import chosen, resolve
from sim.yaskawa.language.arguments import LETTERS, parse_axes, parse_fields, parse_form, values
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import integer
from sim.yaskawa.language.registry import COMMANDS, Command, Outcome, Runner, command
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.trippoints import at_sample, at_speed, motion_complete, path_reached, place_reached, when


@command("WT")
def _wait(text: str) -> Runner:
    value = integer(text)

    def run(c: Context) -> Outcome:
        samples = value(c)
        if samples < 0:
            raise CommandError(6)
        return at_sample(c.machine.now() + samples)

    return run


@command("AT")
def _after_time(text: str) -> Runner:
    value = integer(text)

    def run(c: Context) -> Outcome:
        machine = c.machine
        owner = c.thread or machine.interpreter.threads[0]
        samples = value(c)
        if samples == 0:
            owner.reference = machine.now()
            return None
        due = owner.reference + abs(samples)
        if samples < 0:
            owner.reference = due
        return at_sample(due)

    return run


@command("AI")
def _after_input(text: str) -> Runner:
    value = integer(text)

    def run(c: Context) -> Outcome:
        number = value(c)
        if not 1 <= abs(number) <= len(c.machine.world.inputs):
            raise CommandError(6)
        return when(lambda machine, now: machine.world.inputs[abs(number) - 1] == (number > 0))

    return run


@command("AM")
def _after_move(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "ST")

    def run(c: Context) -> Outcome:
        motion = c.machine.motion
        wanted = resolve(c, names)
        systems = [motion.systems[name] for name in wanted if name in motion.systems]
        axes = [c.machine.axis(name) for name in wanted if name not in motion.systems]
        if not names:
            axes, systems = list(motion.real), list(motion.systems.values())
        return when(
            lambda machine, now: not any(axis.moving for axis in axes) and not any(one.running for one in systems)
        )

    return run


@command("AS")
def _after_speed(text: str) -> Runner:
    names = parse_axes(text, LETTERS + "ST")

    def run(c: Context) -> Outcome:
        motion = c.machine.motion
        wanted = resolve(c, names)
        systems = [motion.systems[name] for name in wanted if name in motion.systems]
        axes = [c.machine.axis(name) for name in wanted if name not in motion.systems]
        return at_speed(axes if names else list(motion.real), systems)

    return run


@command("MC")
def _motion_complete(text: str) -> Runner:
    names = parse_axes(text)
    return lambda c: motion_complete(chosen(c, names), c.machine.now())


@command("AV")
def _after_vector(text: str) -> Runner:
    fields = values(parse_fields(text, 2))

    def run(c: Context) -> Outcome:
        for name, raw in zip(c.machine.model.figures.systems, fields(c), strict=False):
            if raw is not None:
                if raw < 0:
                    raise CommandError(6)
                system = c.machine.motion.systems[name]
                base = 0.0 if c.machine.options.av_absolute else system.mark
                return path_reached(system, base + raw / fixed.ONE)
        raise CommandError(50)

    return run


def enter_place(
    op: str, go: Callable[[Axis, Context, int], Outcome], low: int, table: dict[str, Command] = COMMANDS
) -> None:
    """Enter a trip-point at a place of one axis; `low` is the least that it takes."""

    def compile_place(text: str) -> Runner:
        form = parse_form(text)
        if len(form) != 1:
            raise CommandError(50 if not form else 4)
        name, field = form[0]
        if field is None or isinstance(field, str):
            raise CommandError(51)

        def run(c: Context) -> Outcome:
            place = fixed.truncated(field(c))
            if place < low:
                raise CommandError(6)
            return go(c.machine.axis(name), c, place)

        return run

    command(op, table=table)(compile_place)


def _absolute(axis: Axis, c: Context, place: int) -> Outcome:
    if not axis.moving and not axis.gear.engaged and axis.mode != "cam":
        return None
    return place_reached(axis, place, place >= axis.reference(c.machine.now()), commanded=True)


def _direction(axis: Axis, now: int) -> int:
    velocity = axis.command_velocity(now + 1)
    return -1 if velocity < 0 or (velocity == 0 and axis.mode == "move" and axis.target < axis.command(now)) else 1


def travelled(axis: Axis, c: Context, place: int) -> Outcome:
    """`AD`: so far from the start of the move."""
    if not axis.moving:
        return None
    sign = _direction(axis, c.machine.now())
    goal = axis.move_start + sign * place
    axis.mark = goal
    return place_reached(axis, goal, sign > 0, commanded=True)


def _relative(axis: Axis, c: Context, place: int) -> Outcome:
    if not axis.moving:
        return None
    sign = _direction(axis, c.machine.now())
    goal = fixed.rounded(axis.mark) + sign * place
    axis.mark = goal
    return place_reached(axis, goal, sign > 0, commanded=True)


def _forward(axis: Axis, c: Context, place: int) -> Outcome:
    return place_reached(axis, place, True, commanded=False)


def _reverse(axis: Axis, c: Context, place: int) -> Outcome:
    return place_reached(axis, place, False, commanded=False)


_LEAST = -2147483648
enter_place("AD", travelled, 0)
enter_place("AR", _relative, 0)
enter_place("AP", _absolute, _LEAST)
enter_place("MF", _forward, _LEAST)
enter_place("MR", _reverse, _LEAST)
