"""Loading of a step's part into the controller, without moving, and its verification."""

from collections.abc import Sequence
from fractions import Fraction

from adapters.ppsmc import fleetaxes
from adapters.ppsmc.batches import PpSmcLine, TokenReply
from adapters.ppsmc.lines import switch_text, wait_text
from adapters.ppsmc.lowering import PpSmcAxisMove, PpSmcLowered
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.replies import (
    ASK_INPUTS,
    ASK_OUTPUTS,
    ASK_POSITIONS,
    ASK_PROGRAM,
    ASK_SETTINGS,
    ASK_STATUS,
    ASK_TARGETS,
    FormattedQuery,
    StatusBits,
    leading_number,
    parse_entries,
    parse_settings,
)
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from adapters.ppsmc.watch import require_settings
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal

COMPARED_NS = 2 * NS_PER_S  # for which a comparison of settings counts between steps
PROFILE = ("frun", "ffast", "acc", "dec")


def check_queries(lowered: PpSmcLowered) -> list[FormattedQuery]:
    """Return the queries before loading, and before the commit."""
    queries = [ASK_STATUS, ASK_POSITIONS]
    if lowered.wait is not None:
        queries.append(ASK_INPUTS)
    if lowered.drive is not None:
        queries.append(ASK_OUTPUTS)
    return queries


def require_rest(unit: PpSmcState, lowered: PpSmcLowered, reply: TokenReply) -> PpSmcReading:
    """Check that the controller is idle at the start of the plan, free to move, and the awaited trigger line passive.
    Raises `Refusal`."""
    look = unit.parse_state(reply.first_line(ASK_STATUS), reply.first_line(ASK_POSITIONS), reply.written_ns)
    if look.is_blocked:
        raise Refusal("blocked", "the controller is blocked", "unblock it with `tutti reset`")
    if lowered.moves and look.program_runs:
        raise Refusal("busy", "a program runs in the controller", "wait for its end, or stop it")
    for move in lowered.moves:
        bits, counts = look.bits[move.motor], look.counts[move.motor]
        if not bits & StatusBits.READY:
            raise Refusal("moving", f"axis {move.name} is moving", "wait for its end, or stop it")
        if counts != move.start_counts:
            raise Refusal(
                "other-start",
                f"axis {move.name} is at {counts} counts; the plan starts at {move.start_counts}",
                "plan again from the present position",
            )
        toward = StatusBits.LIMIT_FORWARD if move.distance > 0 else StatusBits.LIMIT_REVERSE
        if bits & toward:
            raise Refusal(
                "limit",
                f"axis {move.name} is on the limit switch that it would move towards",
                "move it in the other direction",
            )
    if lowered.moves and not look.is_idle:
        raise Refusal("moving", "another axis of the controller moves, or it counts", "wait for its end, or stop it")
    if lowered.wait is not None and lowered.wait.is_active(int(reply.first_text(ASK_INPUTS))):
        raise Refusal(
            "line-level",
            f"input {lowered.wait.name} (bit {lowered.wait.bit}) is already active",
            "make it passive first, and check `active` in the fleet file",
        )
    return look


def profile_lines(moves: tuple[PpSmcAxisMove, ...]) -> list[str]:
    """Return the commands for speeds and ramps. `ffast` precedes only the ramps: it is never below `frun` meanwhile."""
    return [
        f"{name}{move.motor}:{value}"
        for move in moves
        if move.shape is not None
        for name, value in zip(PROFILE, profile_values(move), strict=True)
    ]


def profile_values(move: PpSmcAxisMove) -> tuple[int, int, int, int]:
    """Return the values in the order of `PROFILE`."""
    shape = move.running_shape
    return shape.s, shape.f, shape.a, shape.d


def target_lines(unit: PpSmcState, moves: tuple[PpSmcAxisMove, ...]) -> list[str]:
    """Return the commands for absolute targets: if they are sent twice, they do not move twice."""
    format_target = fleetaxes.format_position
    return ["tbc", *(f"tbs{move.motor}:a{format_target(move.end_counts, unit.gears[move.motor])}" for move in moves)]


def program_lines(unit: PpSmcState, lowered: PpSmcLowered) -> list[str]:
    """Return one program line: its input or output first, then all axes together (L3216-L3222)."""
    first = wait_text(lowered.wait) if lowered.wait is not None else ""
    if not first and lowered.drive is not None:
        first = switch_text(lowered.drive)
    move_lines: list[str] = []
    for move in lowered.moves:
        s, f, a, d = profile_values(move)
        move_lines.append(
            f"{move.motor}:a{fleetaxes.format_position(move.end_counts, unit.gears[move.motor])}s{s}r{f}a{a}d{d}"
        )
    return [first, *move_lines, "nl", "end"]


def holds_profiles(unit: PpSmcState, lowered: PpSmcLowered, now_ns: int) -> bool:
    """Return whether the speeds of the move are those of the move before, and the settings were compared a moment
    ago."""
    is_loaded = all(unit.profiles.get(move.motor) == profile_values(move) for move in lowered.moves)
    return is_loaded and now_ns - unit.compared_ns < COMPARED_NS


async def load_targets(
    unit: PpSmcState,
    options: PpSmcOptions | None,
    lowered: PpSmcLowered,
    first: Sequence[str],
    more: Sequence[FormattedQuery] = (),
) -> TokenReply:
    """Load speeds and the target buffer, behind the `first` commands; the reply has `more` queries. options: None: the
    controller holds the rest, so only the target buffer is loaded. Raises `Refusal` when the controller does not store
    them, or was restarted."""
    if options is None:
        reply = await unit.session.send_repeatable(target_lines(unit, lowered.moves), *more, ASK_TARGETS)
        if unit.session.batches.restarted:
            raise Refusal("not-loaded", "the controller was restarted", "home its axes, and arm it again")
        require_targets(unit, lowered, reply.first_line(ASK_TARGETS))
        return reply
    commands = [*first, *profile_lines(lowered.moves), *target_lines(unit, lowered.moves)]
    queries = [*more, ASK_TARGETS, *([ASK_SETTINGS] if options.check_profile else [])]
    reply = await unit.session.send_repeatable(commands, *queries)
    unit.compared_ns = reply.written_ns
    if options.check_profile:
        held_settings = parse_settings(reply.reply_texts(ASK_SETTINGS))
        require_settings(unit, fleetaxes.axis_names(unit.config), held_settings)
        for move in lowered.moves:
            require_profile(move.name, move.motor, profile_values(move), held_settings)
    for move in lowered.moves:
        unit.profiles[move.motor] = profile_values(move)
    require_targets(unit, lowered, reply.first_line(ASK_TARGETS))
    return reply


def require_profile(name: str, motor: int, wanted: tuple[int, int, int, int], held: dict[int, dict[str, str]]) -> None:
    """Raise `Refusal` when ?conf does not show the speeds that were set."""
    for item, value in zip(PROFILE, wanted, strict=True):
        held_text = held.get(motor, {}).get(item)
        if held_text is None or not _is_number(held_text, value):
            raise Refusal(
                "not-loaded",
                f"axis {name}: {item}{motor} is {held_text} instead of {value}",
                "arm it again; does the speed exceed the controller's own limit (fmax)?",
            )


def _is_number(text: str, value: int) -> bool:
    number = leading_number(text)
    return number is not None and Fraction(number) == value


def require_targets(unit: PpSmcState, lowered: PpSmcLowered, line: PpSmcLine) -> None:
    """Raise `Refusal` unless the target buffer contains exactly the step's targets."""
    held_targets = {motor: text for motor, text in parse_entries(line.text).items() if _is_target(text)}
    for move in lowered.moves:
        text = held_targets.pop(move.motor, "")
        number = leading_number(text[1:]) if text[:1].lower() == "a" else None
        held_steps = None if number is None else fleetaxes.parse_steps(number, unit.gears[move.motor])
        if held_steps != move.end_counts:
            raise Refusal(
                "not-loaded",
                f"axis {move.name}: the target buffer contains {text or 'nothing'} instead of step {move.end_counts}",
                "arm it again; was the controller switched off, or does another program use the target buffer?",
            )
    if held_targets:
        raise Refusal(
            "other-targets",
            "the target buffer contains targets of other axes: "
            f"{', '.join(f'{m}:{t}' for m, t in held_targets.items())}",
            "ensure that no other program uses the controller; arm it again",
        )


def _is_target(text: str) -> bool:
    """Return whether an entry of ?tb is a target: `r0` is the state after tbc (L2957); an absolute 0 is a target."""
    number = leading_number(text[1:] if text[:1].lower() in ("a", "r") else text)
    return text[:1].lower() == "a" or (number is not None and Fraction(number) != 0)


async def load_program(unit: PpSmcState, lowered: PpSmcLowered) -> None:
    """Load the program in place of the one in memory. Raises `Refusal` when the controller does not store it."""
    lines = program_lines(unit, lowered)
    # Everything matches the format of program lines: it must be the last.
    reply = await unit.session.send_repeatable(["clr", *lines], ASK_SETTINGS, ASK_PROGRAM)
    require_settings(unit, fleetaxes.axis_names(unit.config), parse_settings(reply.reply_texts(ASK_SETTINGS)))
    require_program(lines, reply.reply_texts(ASK_PROGRAM))


def require_program(lines: list[str], found: list[str]) -> None:
    """Raise `Refusal` when ?pgm does not list `lines`."""
    if [line.rstrip("; ") for line in found] != lines:
        raise Refusal(
            "not-loaded",
            f"the program memory contains {'; '.join(found)[:200] or 'nothing'} instead of {'; '.join(lines)}",
            "arm it again; is the i/o port option installed?",
        )
