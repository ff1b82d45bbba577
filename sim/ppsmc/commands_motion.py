"""Direct commands that move axes or say where they are (section 12.2)."""

import re
from dataclasses import replace
from fractions import Fraction

from sim.ppsmc.axis import Axis
from sim.ppsmc.grammar import Refused, after_colon, decimal, direction, integer, leading_axis, nothing
from sim.ppsmc.homing import home, read_homing
from sim.ppsmc.moves import clock_check, full_step, jogging, oscillating, positioning, reference, single_step
from sim.ppsmc.path import Profile
from sim.ppsmc.registry import Command, Commands, When
from sim.ppsmc.sensors import Switch
from sim.ppsmc.task import Kind, Steps
from sim.ppsmc.unit import Client, Unit

_SPIN_MOST_HZ = 2_457_000
_LATER_PROFILE = re.compile(r"(?:s(\d+))?(?:r(\d+))?(?:a(\d+))?(?:d(\d+))?")


def _addressed(unit: Unit, rest: str) -> tuple[Axis, str]:
    number, rest = leading_axis(rest)
    return unit.machine.axis(number), rest


def _free(axis: Axis) -> None:
    if axis.task is not None:
        raise Refused(f"axis {axis.number} is busy")


def _launch(unit: Unit, client: Client, axis: Axis, kind: Kind, steps: Steps) -> None:
    unit.moved_by(axis, client)
    unit.machine.launch(axis, kind, steps)


# Positioning


def _distance(unit: Unit, axis: Axis, text: str) -> tuple[Fraction, Profile | None]:
    """A distance; later firmware takes a profile for this one move behind `*`."""
    if not unit.modern or "*" not in text:
        return decimal(text), None
    text, _, suffix = text.partition("*")
    match = _LATER_PROFILE.fullmatch(suffix.lower())
    if match is None:
        raise Refused("not a profile")
    start, slew, up, down = (None if part is None else float(part) for part in match.groups())
    profile = axis.settings.profile
    up = profile.acceleration / 1000.0 if up is None else up
    down = up if down is None else down
    if min(up, down, 1.0 if start is None else start, 1.0 if slew is None else slew) < 1.0:
        raise Refused("profile out of range")
    return decimal(text), Profile(start or profile.start, slew or profile.slew, up * 1000.0, down * 1000.0)


def _position(unit: Unit, client: Client, axis: Axis, text: str, absolute: bool, counting: bool = False) -> None:
    """goto, move and movec; for a moving axis the target waits, one at most (decision 13)."""
    distance, own = _distance(unit, axis, text)
    steps = axis.count(distance)
    machine = unit.machine

    def counted(by_itself: bool) -> None:
        del by_itself
        client.say(str(unit.counter.stop()))

    def begin() -> None:
        target = steps if absolute else axis.steps + steps
        machine.check_target(target)
        unit.moved_by(axis, client)
        task = positioning(machine, axis, target, own or axis.settings.profile)
        if counting:
            machine.check_input(axis)
            unit.counter.begin()
        machine.launch(axis, Kind.POSITIONING, task, counted if counting else None)

    def begin_later() -> None:
        try:
            begin()
        except Refused as why:
            if unit.echo:
                client.say(f"error: {why}")

    if axis.task is None:
        begin()
    elif axis.task.kind is Kind.POSITIONING and axis.queued is None and unit.options.queue_target:
        axis.queued = begin_later
    else:
        raise Refused(f"axis {axis.number} is busy")


def _goto(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    _position(unit, client, axis, after_colon(rest), absolute=True)


def _move(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    _position(unit, client, axis, after_colon(rest), absolute=False)


def _movec(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    if unit.counter.counting:
        raise Refused("the counter is busy")
    _position(unit, client, axis, after_colon(rest), absolute=False, counting=True)


# Continuous motion


def _fast(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    _launch(unit, client, axis, Kind.JOG, jogging(direction(rest), axis.settings.profile))


def _run(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    profile = axis.settings.profile
    _launch(unit, client, axis, Kind.JOG, jogging(direction(rest), replace(profile, slew=profile.start)))


def _step(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    _launch(unit, client, axis, Kind.JOG, single_step(axis, direction(rest)))


def _spin(unit: Unit, client: Client, rest: str) -> None:
    """While an axis spins, another spin of the same axis is taken (L2854)."""
    axis, rest = _addressed(unit, rest)
    text = after_colon(rest)
    sign = direction(text[:1])
    profile = axis.settings.profile
    if text[1:]:
        profile = replace(profile, slew=float(integer(text[1:], 1, _SPIN_MOST_HZ)))
    if axis.task is not None and axis.task.kind is Kind.SPIN and axis.run is not None and not axis.run.stopping:
        unit.machine.check_input(axis)
        unit.machine.drive.respin(axis.run, sign, profile)
    elif unit.idle:
        _launch(unit, client, axis, Kind.SPIN, jogging(sign, profile))
    else:
        raise Refused("not allowed during positioning")


def _osc(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    amplitude = axis.count(decimal(after_colon(rest)))
    if not amplitude:
        if axis.task is not None and axis.task.kind is Kind.OSCILLATION:
            unit.machine.stop(axis)
        return
    _free(axis)
    for side in (1, -1):
        unit.machine.check_target(axis.steps + side * amplitude)
    _launch(unit, client, axis, Kind.OSCILLATION, oscillating(unit.machine, axis, amplitude))


def _quit(unit: Unit, client: Client, rest: str) -> None:
    del client
    number, rest = leading_axis(rest)
    nothing(rest)
    if number is None or number == 0:
        unit.stop_all()
    else:
        unit.machine.stop(unit.machine.axis(number))


# Homing and coordinates


def _home(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    _free(axis)
    if rest and not rest.startswith(":"):
        raise Refused(f"'{rest}' not expected")
    homing = read_homing(rest[1:])
    steps = home(axis, homing)
    if homing.moves:
        unit.machine.check_input(axis)
    _launch(unit, client, axis, Kind.HOMING, steps)


def _search(unit: Unit, client: Client, rest: str, switch: Switch, directed: bool) -> None:
    axis, rest = _addressed(unit, rest)
    if not directed:
        nothing(rest)
    rest = rest.removeprefix(":")
    sign = direction(rest) if rest else -1
    if switch is Switch.INDEX or not axis.referenced:
        _launch(unit, client, axis, Kind.HOMING, reference(axis, sign, switch))


def _ref(unit: Unit, client: Client, rest: str) -> None:
    if not rest:
        for axis in unit.machine.axes:
            _search(unit, client, axis.name, Switch.ORG, directed=False)
    else:
        _search(unit, client, rest, Switch.ORG, directed=False)


def _org(unit: Unit, client: Client, rest: str) -> None:
    _search(unit, client, rest, Switch.ORG, directed=True)


def _eref(unit: Unit, client: Client, rest: str) -> None:
    axis, _ = _addressed(unit, rest)
    if axis.encoder is None:
        raise Refused(f"axis {axis.number} has no encoder")
    _search(unit, client, rest, Switch.INDEX, directed=True)


def _pos(unit: Unit, client: Client, rest: str) -> None:
    del client
    axis, rest = _addressed(unit, rest)
    steps = axis.count(decimal(after_colon(rest)))
    unit.machine.check_target(steps)
    axis.set_counter(steps)


def _zero(unit: Unit, client: Client, rest: str) -> None:
    del client
    number, rest = leading_axis(rest)
    nothing(rest)
    for axis in unit.machine.some(number or None):
        axis.set_counter(axis.count(axis.settings.rofs))


def _sync(unit: Unit, client: Client, rest: str) -> None:
    """`p` (or nothing): position := encoder; `e`: encoder := position (L2942-L2950)."""
    del client
    number, rest = leading_axis(rest)
    mode = after_colon(rest).lower() if rest else "p"
    if mode not in ("p", "e"):
        raise Refused("mode is 'p' or 'e'")
    machine = unit.machine
    for axis in machine.some(number or None):
        if axis.encoder is None:
            continue
        if mode == "e":
            axis.load_encoder(axis.distance(axis.steps))
        else:
            axis.set_counter(axis.count(machine.measured(axis)))


def _lpox(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    for axis, steps in zip(unit.machine.axes, unit.disk.positions or (), strict=False):
        axis.set_counter(steps)


# Target buffer


def _tbc(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    for axis in unit.machine.axes:
        axis.target = None


def _tbs(unit: Unit, client: Client, rest: str) -> None:
    del client
    axis, rest = _addressed(unit, rest)
    text = after_colon(rest)
    absolute = text[:1].lower() == "a"
    distance = decimal(text[1:] if text[:1].lower() in ("a", "r") else text)
    unit.machine.check_target(axis.count(distance))
    axis.target = (absolute, distance) if absolute or distance else None


def _tbg(unit: Unit, client: Client, rest: str) -> None:
    """All axes with a target start together; a limit switch that is active stops the group, without iel (L2994)."""
    ignore = rest.lower() == ":iel"
    if rest and not ignore:
        raise Refused(f"'{rest}' not expected")
    machine = unit.machine
    if not ignore and machine.any_limit:
        raise Refused("limit switch active")
    targets: list[tuple[Axis, int]] = []
    for axis in machine.axes:
        if axis.target is not None:
            absolute, distance = axis.target
            target = axis.count(distance) + (0 if absolute else axis.steps)
            machine.check_target(target)
            targets.append((axis, target))
    refused: list[str] = []
    for axis, target in targets:
        start_ns = machine.start_ns() if len(targets) > 1 else None
        steps = positioning(machine, axis, target, axis.settings.profile, at_ns=start_ns)
        try:
            _launch(unit, client, axis, Kind.POSITIONING, steps)
        except Refused as why:
            refused.append(str(why))
    if not unit.options.keep_target_buffer:
        _tbc(unit, client, "")
    if refused:
        raise Refused(", ".join(refused))


# Special


def _ffst(unit: Unit, client: Client, rest: str) -> None:
    axis, rest = _addressed(unit, rest)
    if axis.number > 8:
        raise Refused("axes 1 to 8 only")
    _launch(unit, client, axis, Kind.JOG, full_step(unit.machine, axis, direction(after_colon(rest))))


def _sysclk(unit: Unit, client: Client, rest: str) -> None:
    nothing(rest)
    axis = unit.machine.axis(1)
    if any(unit.machine.limit_on(axis, switch) for switch in (Switch.EL_MINUS, Switch.EL_PLUS)):
        raise Refused("limit switch of axis 1 active")
    _launch(unit, client, axis, Kind.POSITIONING, clock_check(axis))


MOTION: Commands = {
    "eref": Command(_eref, When.IDLE, "search encoder reference"),
    "fast": Command(_fast, When.IDLE, "move continuously at slew speed"),
    "ffst": Command(_ffst, When.IDLE, "find next full-step motor position", needs="full_step"),
    "goto": Command(_goto, When.NOT_PROGRAM, "move axis to absolute position"),
    "home": Command(_home, When.NOT_PROGRAM, "execute homing procedure"),
    "lpox": Command(_lpox, When.IDLE, "load position values"),
    "move": Command(_move, When.NOT_PROGRAM, "execute relative movement"),
    "movec": Command(_movec, When.NOT_PROGRAM, "execute relative movement and count", needs="counter"),
    "org": Command(_org, When.IDLE, "search reference position"),
    "osc": Command(_osc, When.ALWAYS, "start oscillation"),
    "pos": Command(_pos, When.IDLE, "set position display"),
    "q": Command(_quit, When.ALWAYS, "cancel positioning task", names=("quit", "stop")),
    "ref": Command(_ref, When.IDLE, "search reference position"),
    "run": Command(_run, When.IDLE, "move continuously at start-stop speed"),
    "spin": Command(_spin, When.ALWAYS, "start continuous motion"),
    "step": Command(_step, When.IDLE, "execute single motor step"),
    "sync": Command(_sync, When.IDLE, "synchronize position"),
    "sysclk": Command(_sysclk, When.IDLE, "check system clock setting"),
    "tbc": Command(_tbc, When.IDLE, "clear target buffer"),
    "tbg": Command(_tbg, When.IDLE, "start positioning task according to the target buffer"),
    "tbs": Command(_tbs, When.IDLE, "set target buffer"),
    "zero": Command(_zero, When.IDLE, "set position display to zero"),
}
"""Motion commands by name."""
