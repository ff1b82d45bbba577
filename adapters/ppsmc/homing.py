"""Reference searches in the unit's documented ways (L1852, L2039-L2110, L2329, L2568).

default, org   `org` with the axis's direction: the ORG switch; nothing moves if a reference is installed already
ref            `ref`: the same, always in negative direction
index          `eref`: the encoder's index
switch         `home` with hs: the limit switch at the end of the direction, then the ORG switch, position 0
slowdown       `home` with hsd: the same with the SD switch
limit          `home` with jg alone: the limit switch, released again; the adapter makes that position 0
here           `home` alone: no motion, the place where the axis stands
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import floor

from adapters.contract import CannotDo, DriverFault
from adapters.ppsmc import fleetaxes, loading
from adapters.ppsmc.replies import ASK_POSITIONS, ASK_SETTINGS, ASK_STATUS, Bits, settings
from adapters.ppsmc.unitstate import Look, UnitState
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Axis, Controller

_LOOK_NS = 100 * NS_PER_MS
_LAG_NS = 500 * NS_PER_MS  # ready bits may lag behind a start
_ALONE = ("default", "org", "ref", "index")  # not allowed while another axis moves


@dataclass(slots=True)
class _Search:
    """One axis that looks for its reference. target: its position then, steps. stops: how many it had been given.
    begun_ns: when it was begun."""

    axis: str
    motor: int
    method: str
    command: str
    profile: tuple[int, int, int, int]
    target: int
    stops: int
    begun_ns: int = 0

    @property
    def alone(self) -> bool:
        return self.method in _ALONE


async def home(
    config: Controller, clock: Clock, unit: UnitState, axes: Sequence[str], found: Callable[[str], None]
) -> Mapping[str, CannotDo]:
    """Find the references of `axes`. Gives those that have not. Raises `CannotDo` when none was begun."""
    unit.require_enabled(axes)
    waiting = [_search(config, unit, name) for name in axes]
    failed: dict[str, CannotDo] = {}
    running: list[_Search] = []
    async with unit.loading:
        look = await _prepared(unit, waiting)
        for each in list(waiting):
            if each.method in ("default", "org", "ref") and look.bits[each.motor] & Bits.REFERENCED:
                waiting.remove(each)
                if each.motor in unit.spoiled:
                    failed[each.axis] = _installed_already(each)
                else:
                    found(each.axis)  # the unit vouches for it, and would not move (L2333)
    if failed and not waiting and len(failed) == len(axes):
        raise next(iter(failed.values()))
    try:
        while waiting or running:
            for each in list(waiting):
                if not running or not (each.alone or running[0].alone):
                    waiting.remove(each)
                    await unit.set_going(each.command, each.axis, each.motor, each.stops)
                    each.begun_ns = clock.now_ns()
                    running.append(each)
            await sleep_ns(clock, _LOOK_NS)
            look = await unit.look()
            for each in [each for each in running if look.ready(each.motor) or look.blocked]:
                why = await _judged(unit, each, look)
                if why == "" or clock.now_ns() > each.begun_ns + _LAG_NS or unit.session.restarted:
                    running.remove(each)
                    if why:
                        text = f"axis {each.axis} has not found its reference: {why}"
                        failed[each.axis] = CannotDo("homing-failed", text, "look at its switches and `homing`")
                    else:
                        unit.spoiled.discard(each.motor)
                        found(each.axis)
    except BaseException:
        # Nobody waits any more for those that look for it.
        with suppress(LinkClosed):
            unit.brake(each.motor for each in running)
        raise
    return failed


async def _prepared(unit: UnitState, searches: Sequence[_Search]) -> Look:
    """Errors cleared and speeds loaded, all while nothing moves. Raises `CannotDo`."""
    heard = await unit.session.ask(ASK_STATUS, ASK_POSITIONS)
    look = unit.looked(heard.one(ASK_STATUS), heard.one(ASK_POSITIONS), heard.written_ns)
    if not look.idle:
        raise CannotDo("moving", "an axis of the controller moves, or a program runs", "wait, or stop it")
    commands = [f"cerr{each.motor}" for each in searches]
    for each in searches:
        commands += [f"{n}{each.motor}:{v}" for n, v in zip(loading.PROFILE, each.profile, strict=True)]
    held = settings((await unit.session.say(commands, ASK_SETTINGS)).lines(ASK_SETTINGS))
    for each in searches:
        loading.require_profile(each.axis, each.motor, each.profile, held)
        unit.profiles[each.motor] = each.profile
        unit.referenced.discard(each.motor)
    return look


def _search(config: Controller, unit: UnitState, name: str) -> _Search:
    axis = config.axes[name]
    motor, method, direction = fleetaxes.motor(axis), axis.homing.method, axis.homing.direction
    s, f, ramp, fine = _speeds(axis)
    sign = "-" if direction == "negative" else "+"
    jog = f"jg{'-' if direction == 'negative' else ''}{f}"
    free = f"{'hr' if direction == 'negative' else 'hm'}0;vl{fine}"
    commands = {
        "default": f"org{motor}{sign}",
        "org": f"org{motor}{sign}",
        "ref": f"ref{motor}",
        "index": f"eref{motor}{sign}",
        "switch": f"home{motor}:hs;{jog};{free}",
        "slowdown": f"home{motor}:hsd;{jog};{free}",
        "limit": f"home{motor}:{jog}",
        "here": f"home{motor}",
    }
    at_zero = method in ("switch", "slowdown", "limit")
    start = min(f, s if at_zero else fine)
    return _Search(
        axis=name,
        motor=motor,
        method=method,
        command=commands[method],
        profile=(start, max(f, start), ramp, ramp),
        target=0 if at_zero else unit.homes.get(motor, 0),
        stops=unit.stops_given(motor),
    )


def _speeds(axis: Axis) -> tuple[int, int, int, int]:
    """Start speed, approach speed (steps/s), ramp (Hz/ms), and the speed of the fine search."""
    limits, homing, scale = fleetaxes.bounds(axis), axis.homing, float(axis.scale)
    f = floor((homing.speed if homing.speed is not None else axis.limits.velocity / 10) * scale)
    f = max(1, limits.start_min, min(f, floor(limits.speed)))
    highest = max(limits.start_min, min(limits.start_max, f))
    if limits.ramp_max < 1:
        f = highest  # it can not speed up as gently as it must, and so runs at its start speed
    fine = highest
    if homing.search_speed is not None:
        fine = max(limits.start_min, min(highest, floor(homing.search_speed * scale)))
    return highest, f, max(1, limits.ramp_max), fine


async def _judged(unit: UnitState, search: _Search, look: Look) -> str:
    """What is wrong with a search whose axis is at rest; "" when it has found its reference."""
    motor, bits = search.motor, look.bits[search.motor]
    if unit.session.restarted:
        return "the unit was restarted"
    if unit.stops_given(motor) != search.stops or look.blocked:
        return "it was stopped"
    try:
        number, text = (await unit.errors()).get(motor, (0, ""))
    except DriverFault:
        return "the unit did not say how it ended"
    if number:
        return f"the unit reports error {number} {text}".rstrip()
    if search.method == "limit":
        if not _limit_was_reached(search, look):
            return "it stands where it stood"
        return await _made_zero(unit, search)
    if not bits & (Bits.REFERENCED if search.method != "index" else 1 << 10):
        return "no reference is installed"
    if look.counts[motor] != search.target:
        return f"it stands at {look.counts[motor]} steps, not at {search.target}"
    return ""


def _limit_was_reached(search: _Search, look: Look) -> bool:
    """Off the switch again: that is where `jg` ends (L2062)."""
    return not look.bits[search.motor] & (Bits.LIMIT_FORWARD | Bits.LIMIT_REVERSE)


async def _made_zero(unit: UnitState, search: _Search) -> str:
    async with unit.loading:
        heard = await unit.session.say((f"pos{search.motor}:0",), ASK_STATUS, ASK_POSITIONS)
    look = unit.looked(heard.one(ASK_STATUS), heard.one(ASK_POSITIONS), heard.written_ns)
    return "" if look.counts[search.motor] == 0 else "its position could not be set: another axis moves"


def _installed_already(search: _Search) -> CannotDo:
    return CannotDo(
        "already-referenced",
        f"axis {search.axis} was stopped by a limit switch, but the unit holds its reference to be installed, and "
        f"`{search.command}` moves nothing then",
        "use homing method switch or limit, or switch the unit off and on",
    )
