"""Putting a step's part into the unit, without moving, and reading it back."""

from fractions import Fraction

from adapters.contract import CannotDo
from adapters.ppsmc import fleetaxes
from adapters.ppsmc.lowering import AxisMove, SmcLowered
from adapters.ppsmc.options import Options
from adapters.ppsmc.replies import (
    ASK_INPUTS,
    ASK_OUTPUTS,
    ASK_POSITIONS,
    ASK_PROGRAM,
    ASK_SETTINGS,
    ASK_STATUS,
    ASK_TARGETS,
    Bits,
    Query,
    entries,
    number_in,
    settings,
)
from adapters.ppsmc.session import Heard, Line
from adapters.ppsmc.unitstate import Look, UnitState

PROFILE = ("frun", "ffast", "acc", "dec")


def checks(lowered: SmcLowered) -> list[Query]:
    """What is asked before loading, and before the promise."""
    queries = [ASK_STATUS, ASK_POSITIONS]
    if lowered.wait is not None:
        queries.append(ASK_INPUTS)
    if lowered.drive is not None:
        queries.append(ASK_OUTPUTS)
    return queries


def require_rest(unit: UnitState, lowered: SmcLowered, heard: Heard) -> Look:
    """Idle, where the plan starts, free to go, and the waited line passive. Raises `CannotDo`."""
    look = unit.looked(heard.one(ASK_STATUS), heard.one(ASK_POSITIONS), heard.written_ns)
    if look.blocked:
        raise CannotDo("blocked", "the controller is blocked", "release it with `tutti reset`")
    if lowered.moves and look.program:
        raise CannotDo("busy", "a program runs in the controller", "wait for its end, or stop it")
    for each in lowered.moves:
        bits, counts = look.bits[each.motor], look.counts[each.motor]
        if not bits & Bits.READY:
            raise CannotDo("moving", f"axis {each.name} is moving", "wait, or stop it")
        if counts != each.start_counts:
            raise CannotDo(
                "other-start",
                f"axis {each.name} stands at {counts} counts; the plan starts at {each.start_counts}",
                "plan again from where it stands",
            )
        toward = Bits.LIMIT_FORWARD if each.distance > 0 else Bits.LIMIT_REVERSE
        if bits & toward:
            raise CannotDo(
                "limit", f"axis {each.name} is on the limit switch that it would move towards", "move it the other way"
            )
    if lowered.moves and not look.idle:
        raise CannotDo("moving", "another axis of the controller moves, or it counts", "wait, or stop it")
    if lowered.wait is not None and lowered.wait.is_active(int(heard.text(ASK_INPUTS))):
        raise CannotDo(
            "line-level",
            f"input {lowered.wait.name} (bit {lowered.wait.bit}) is active already",
            "make it passive first, and look at `active` in the fleet file",
        )
    return look


def profile_lines(moves: tuple[AxisMove, ...]) -> list[str]:
    """Speeds and ramps. `ffast` last but for the ramps: it is never below `frun` on the way."""
    return [
        f"{name}{each.motor}:{value}"
        for each in moves
        if each.shape is not None
        for name, value in zip(PROFILE, shape_of(each), strict=True)
    ]


def shape_of(move: AxisMove) -> tuple[int, int, int, int]:
    """Values in the order of `PROFILE`."""
    assert move.shape is not None
    return move.shape.s, move.shape.f, move.shape.a, move.shape.d


def target_lines(unit: UnitState, moves: tuple[AxisMove, ...]) -> list[str]:
    """Absolute targets: given twice, they move nothing twice."""
    written = fleetaxes.written
    return ["tbc", *(f"tbs{each.motor}:a{written(each.end_counts, unit.gears[each.motor])}" for each in moves)]


def program_lines(unit: UnitState, lowered: SmcLowered) -> list[str]:
    """One program line: its input or output first, then all axes together (L3216-L3222)."""
    first = lowered.wait.command if lowered.wait is not None else ""
    if not first and lowered.drive is not None:
        first = lowered.drive.command
    moving: list[str] = []
    for each in lowered.moves:
        s, f, a, d = shape_of(each)
        moving.append(f"{each.motor}:a{fleetaxes.written(each.end_counts, unit.gears[each.motor])}s{s}r{f}a{a}d{d}")
    return [first, *moving, "nl", "end"]


async def load_targets(unit: UnitState, options: Options, lowered: SmcLowered) -> None:
    """Speeds and the target buffer. Raises `CannotDo` when the unit does not hold them."""
    commands = [*profile_lines(lowered.moves), *target_lines(unit, lowered.moves)]
    queries = [ASK_TARGETS, *([ASK_SETTINGS] if options.check_profile else [])]
    heard = await unit.session.settle(commands, *queries)
    if options.check_profile:
        held = settings(heard.lines(ASK_SETTINGS))
        for each in lowered.moves:
            require_profile(each.name, each.motor, shape_of(each), held)
    for each in lowered.moves:
        unit.profiles[each.motor] = shape_of(each)
    require_targets(unit, lowered, heard.one(ASK_TARGETS))


def require_profile(name: str, motor: int, wanted: tuple[int, int, int, int], held: dict[int, dict[str, str]]) -> None:
    """Raises `CannotDo` when ?conf does not show the speeds that were given."""
    for item, value in zip(PROFILE, wanted, strict=True):
        found = held.get(motor, {}).get(item)
        if found is None or not _is_number(found, value):
            raise CannotDo(
                "not-loaded",
                f"axis {name}: {item}{motor} is {found} instead of {value}",
                "arm again; is the speed beyond the unit's own limit (fmax)?",
            )


def _is_number(text: str, value: int) -> bool:
    number = number_in(text)
    return number is not None and Fraction(number) == value


def require_targets(unit: UnitState, lowered: SmcLowered, line: Line) -> None:
    """Raises `CannotDo` unless the target buffer holds the step's targets and no others."""
    held = {motor: text for motor, text in entries(line.text).items() if _is_target(text)}
    for each in lowered.moves:
        text = held.pop(each.motor, "")
        number = number_in(text[1:]) if text[:1].lower() == "a" else None
        found = None if number is None else fleetaxes.steps(number, unit.gears[each.motor])
        if found != each.end_counts:
            raise CannotDo(
                "not-loaded",
                f"axis {each.name}: the target buffer holds {text or 'nothing'} instead of step {each.end_counts}",
                "arm again; was the unit switched off, or does another program use the target buffer?",
            )
    if held:
        raise CannotDo(
            "other-targets",
            f"the target buffer holds targets of other axes: {', '.join(f'{m}:{t}' for m, t in held.items())}",
            "see that no other program uses the unit; arm again",
        )


def _is_target(text: str) -> bool:
    """Whether an entry of ?tb is a target: `r0` is what tbc leaves (L2957); an absolute 0 is one."""
    number = number_in(text[1:] if text[:1].lower() in ("a", "r") else text)
    return text[:1].lower() == "a" or (number is not None and Fraction(number) != 0)


async def load_program(unit: UnitState, lowered: SmcLowered) -> None:
    """The program in place of the one in memory. Raises `CannotDo` when the unit does not hold it."""
    lines = program_lines(unit, lowered)
    heard = await unit.session.settle(["clr", *lines], ASK_PROGRAM)
    require_program(lines, heard.lines(ASK_PROGRAM))


def require_program(lines: list[str], found: list[str]) -> None:
    """Raises `CannotDo` when ?pgm does not list `lines`."""
    if [line.rstrip("; ") for line in found] != lines:
        raise CannotDo(
            "not-loaded",
            f"the program memory holds {'; '.join(found)[:200] or 'nothing'} instead of {'; '.join(lines)}",
            "arm again; is the i/o port option installed?",
        )
