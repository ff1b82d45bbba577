"""Linear and vector sequences: CA LM LI LE VM VP CR VE CS VS VA VD VR VT ES TN (L3326-L3924, L11169-L11711)."""

from collections.abc import Callable
from dataclasses import dataclass

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.arguments import (
    LETTERS,
    canonical_axis,
    compile_values,
    parse_axes,
    parse_fields,
    split_fields,
)
from sim.yaskawa.language.context import CommandContext, Evaluator
from sim.yaskawa.language.expressions import compile_expression
from sim.yaskawa.language.registry import Outcome, Runner, register_command
from sim.yaskawa.motion.segments import ArcShape, arc_segment, linear_segment
from sim.yaskawa.motion.sequence import CoordinateSystem

Speeds = tuple[Evaluator | None, Evaluator | None]


def find_system(c: CommandContext, name: str = "") -> CoordinateSystem:
    """Return the coordinate system named, or the one that `CA` has selected."""
    system = c.machine.motion.systems.get(name or c.machine.system_letter)
    if system is None:
        raise CommandError(28)
    return system


def _with_speeds(text: str) -> tuple[str, Speeds]:
    """Separate `<n` and `>m` from the fields of a segment."""
    head, entry, leave = text, None, None
    if ">" in head:
        head, _, tail = head.partition(">")
        if "<" in tail:
            tail, _, speed_text = tail.partition("<")
            entry = compile_expression(speed_text)
        leave = compile_expression(tail)
    if "<" in head:
        head, _, tail = head.partition("<")
        entry = compile_expression(tail)
    return head, (entry, leave)


def _evaluate_speeds(c: CommandContext, speeds: Speeds) -> tuple[float | None, float | None]:
    values: list[float | None] = []
    for evaluator, highest in zip(speeds, c.machine.model.figures.fastest, strict=True):
        if evaluator is None:
            values.append(None)
            continue
        speed = fixed.to_integer(evaluator(c))
        if not 0 <= speed <= highest:
            raise CommandError(6)
        values.append(float(speed // 2 * 2))
    return values[0], values[1]


@register_command("CA")
def _compile_select_system(text: str) -> Runner:
    if text not in ("S", "T"):
        raise CommandError(4)

    def run_command(c: CommandContext) -> Outcome:
        c.machine.system_letter = text
        return None

    return run_command


def _open_sequence(c: CommandContext, axes: tuple[str, ...], tangent: str | None = None, *, linear: bool) -> None:
    system = find_system(c)
    if system.running:
        raise CommandError(7)
    for name in (*axes, *([tangent] if tangent else [])):
        axis = c.machine.find_axis(name)
        if axis.is_moving:
            raise CommandError(18 if axis.mode == "contour" else 29 if axis.mode == "sequence" else 7)
    system.select_axes(axes, linear=linear, tangent=tangent)


@register_command("LM")
def _compile_linear_mode(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_answer(
            "LM", fixed.from_integer(find_system(c).free_entries(c.machine.current_sample()))
        )
    names = parse_axes(text)

    def run_command(c: CommandContext) -> Outcome:
        axes = tuple(c.machine.find_axis(name).name for name in names) or tuple(c.machine.letters)
        _open_sequence(c, axes, linear=True)
        return None

    return run_command


@register_command("VM")
def compile_vector_mode(text: str) -> Runner:
    """`VM`: the plane and optionally the tangent axis; commas between them are not necessary (L13282)."""
    names = parse_axes(text.replace(",", ""), LETTERS + "N")
    if len(names) not in (0, 2, 3):
        raise CommandError(50)

    def run_command(c: CommandContext) -> Outcome:
        axes = tuple(c.machine.find_axis(name).name for name in names) or ("X", "Y", "N")
        _open_sequence(c, axes[:2], linear=False, tangent=axes[2] if len(axes) > 2 and axes[2] != "N" else None)
        return None

    return run_command


@register_command("LI")
def _compile_linear_segment(text: str) -> Runner:
    head, speeds = _with_speeds(text)
    if head[1:2] == "=":
        head = "," * LETTERS.find(canonical_axis(head[0])) + head[2:]
    fields = compile_values(parse_fields(head))

    def run_command(c: CommandContext) -> Outcome:
        system = find_system(c)
        if not system.axes:
            raise CommandError(24)
        if not system.linear:
            raise CommandError(33)
        if system.ended:
            restart_system(system)
        given_fields = fields(c)
        steps: dict[str, int] = {}
        for letter, raw in zip(LETTERS, given_fields, strict=False):
            if raw is None:
                continue
            step = fixed.to_integer(raw)
            if abs(step) > 8388607:
                raise CommandError(6)
            if letter not in system.axes and step:
                raise CommandError(4)
            steps[letter] = step
        if not steps:
            raise CommandError(50)
        start = system.queue_end()
        end = tuple(a + steps.get(name, 0) for a, name in zip(start, system.axes, strict=True))
        if start == end and c.machine.options.zero_segments:
            return None
        entry, leave = _evaluate_speeds(c, speeds)
        system.add_segment(
            linear_segment(start, end, (1.0,) * len(start), entry, leave), c.machine.timebase.next_sample()
        )
        return None

    return run_command


def restart_system(system: CoordinateSystem) -> None:
    """Start a new queue: a segment after the end of a queue that does not run begins a new one; after a running one
    it is too late."""
    if system.running:
        raise CommandError(7)
    system.clear_queue()


def _require_plane(c: CommandContext) -> CoordinateSystem:
    system = find_system(c)
    if not system.axes:
        raise CommandError(24)
    if system.linear:
        raise CommandError(33)
    if system.ended:
        restart_system(system)
    return system


@register_command("VP")
def _compile_vector_point(text: str) -> Runner:
    head, speeds = _with_speeds(text)
    fields = compile_values(parse_fields(head, 2))

    def run_command(c: CommandContext) -> Outcome:
        system = _require_plane(c)
        given_fields = fields(c)
        start, scale = system.queue_end(), system.ellipse
        end = tuple(
            start[index] if raw is None else fixed.to_integer(raw) * scale[index]
            for index, raw in enumerate([*given_fields, None][:2])
        )
        if start == end and c.machine.options.zero_segments:
            return None
        entry, leave = _evaluate_speeds(c, speeds)
        segment = linear_segment(start, end, scale, entry, leave)
        if segment.length > 8_000_000:
            raise CommandError(6)
        system.add_segment(segment, c.machine.timebase.next_sample())
        return None

    return run_command


@register_command("CR")
def _compile_circle(text: str) -> Runner:
    head, speeds = _with_speeds(text)
    fields = compile_values(parse_fields(head, 3))

    def run_command(c: CommandContext) -> Outcome:
        system = _require_plane(c)
        given_fields = [raw for raw in fields(c) if raw is not None]
        if len(given_fields) != 3:
            raise CommandError(50)
        radius, angle, sweep = (raw / fixed.ONE for raw in given_fields)
        if not 10 <= radius <= 6_000_000 or abs(angle) > 32000 or not 0.0001 <= abs(sweep) <= 32000:
            raise CommandError(6)
        if radius * abs(sweep) > 4.5e8:
            raise CommandError(6)
        entry, leave = _evaluate_speeds(c, speeds)
        segment = arc_segment(system.queue_end(), ArcShape(radius, angle, sweep, system.ellipse), entry, leave)
        system.add_segment(segment, c.machine.timebase.next_sample())
        return None

    return run_command


@register_command("LE", "VE")
def _compile_end_sequence(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_variable(fixed.from_real(find_system(c).length))
    if text not in ("", "S", "T"):
        raise CommandError(4)

    def run_command(c: CommandContext) -> Outcome:
        system = find_system(c, text)
        if not system.axes:
            raise CommandError(24)
        system.finish_queue(c.machine.timebase.next_sample())
        return None

    return run_command


@register_command("CS")
def _compile_clear_sequence(text: str) -> Runner:
    if text not in ("", "S", "T"):
        raise CommandError(4)

    def run_command(c: CommandContext) -> Outcome:
        system = find_system(c, text)
        if system.running:
            raise CommandError(7)
        system.clear_queue()
        system.last_index = 0
        return None

    return run_command


@dataclass(frozen=True, slots=True)
class SystemParameter:
    """A parameter of the systems S and T, cut to its step (raw) or, `nearest`, rounded to it.

    moving: may be set while its system moves."""

    low: float
    high: float
    step: int
    moving: bool = True
    nearest: bool = False

    def accept_value(self, raw: int) -> float:
        """Return the stored value."""
        return (raw + (self.step // 2 if self.nearest else 0)) // self.step * self.step / fixed.ONE


def _register_parameter(op: str, parameter: SystemParameter, write: Callable[[CoordinateSystem, float], None]) -> None:
    """Register the command of a parameter."""

    def compile_register(text: str) -> Runner:
        if text in ("?", "S?", "T?"):
            reader = OPERAND_READERS[op]
            return lambda c: c.machine.format_answer(op, fixed.from_real(reader(find_system(c, text[:-1]))))
        if text[1:2] == "=" and text[0] in "ST":
            fields = [compile_expression(text[2:])]
            names = [text[0]]
        else:
            parts = split_fields(text)
            if len(parts) > 2 or not text:
                raise CommandError(4 if text else 50)
            fields = [compile_expression(part) for part in parts if part]
            names = [name for name, part in zip("ST", parts, strict=False) if part]

        def run_command(c: CommandContext) -> Outcome:
            given_systems = [(find_system(c, name), field(c)) for name, field in zip(names, fields, strict=True)]
            for system, raw in given_systems:
                if not fixed.from_real(parameter.low) <= raw <= fixed.from_real(parameter.high):
                    raise CommandError(6)
                if system.running and not parameter.moving:
                    raise CommandError(7)
            for system, raw in given_systems:
                write(system, parameter.accept_value(raw))
                if system.running:
                    system.replan_speed(c.machine.timebase.next_sample())
            return None

        return run_command

    register_command(op)(compile_register)


OPERAND_READERS: dict[str, Callable[[CoordinateSystem], float]] = {
    "VS": lambda system: system.speed,
    "VA": lambda system: system.acceleration,
    "VD": lambda system: system.deceleration,
    "VR": lambda system: system.ratio,
    "VT": lambda system: system.smoothing,
}


def _set_speed(system: CoordinateSystem, value: float) -> None:
    system.speed = value


def _set_acceleration(system: CoordinateSystem, value: float) -> None:
    system.acceleration = value


def _set_deceleration(system: CoordinateSystem, value: float) -> None:
    system.deceleration = value


def _set_ratio(system: CoordinateSystem, value: float) -> None:
    system.ratio = value


def _set_smoothing(system: CoordinateSystem, value: float) -> None:
    system.smoothing = value


_register_parameter("VS", SystemParameter(2, 8_000_000, 2 * fixed.ONE), _set_speed)
_register_parameter("VA", SystemParameter(1024, 68431360, 1024 * fixed.ONE), _set_acceleration)
_register_parameter("VD", SystemParameter(1024, 68431360, 1024 * fixed.ONE, moving=False), _set_deceleration)
_register_parameter("VR", SystemParameter(0, 10, 1), _set_ratio)
_register_parameter("VT", SystemParameter(0.004, 1, fixed.ONE // 256, nearest=True), _set_smoothing)


@register_command("ES")
def _compile_ellipse(text: str) -> Runner:
    fields = compile_values(parse_fields(text, 2))

    def run_command(c: CommandContext) -> Outcome:
        given_fields = [raw for raw in fields(c) if raw is not None]
        if len(given_fields) != 2:
            raise CommandError(50)
        m, n = (fixed.to_integer(raw) for raw in given_fields)
        if not (1 <= m <= 65535 and 1 <= n <= 65535):
            raise CommandError(6)
        system = find_system(c)
        system.ellipse_terms = (m, n)
        system.ellipse = (m / n, 1.0) if m > n else (1.0, n / m)
        return None

    return run_command


@register_command("TN")
def compile_tangent(text: str) -> Runner:
    """`TN m,n`: scale and zero of the tangent axis."""
    if not text:
        raise CommandError(50)
    fields = compile_values(parse_fields(text, 2))

    def run_command(c: CommandContext) -> Outcome:
        given_fields = [*fields(c), None]
        system = find_system(c)
        if given_fields[0] is not None:
            if abs(given_fields[0]) > 127 * fixed.ONE:
                raise CommandError(6)
            system.tangent_scale = given_fields[0] // 256 * 256 / fixed.ONE
        if given_fields[1] is not None:
            if abs(given_fields[1]) > 2_000_000_000 * fixed.ONE:
                raise CommandError(6)
            system.tangent_zero = float(fixed.to_integer(given_fields[1]))
        return None

    return run_command
