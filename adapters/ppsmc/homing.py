"""Reference searches by the controller's documented methods (L1852, L2039-L2110, L2329, L2568).

default, org   `org` with the axis's direction: the ORG switch; nothing moves if a reference is installed already
ref            `ref`: the same, always in negative direction
index          `eref`: the encoder's index
switch         `home` with hs: the limit switch at the end of the direction, then the ORG switch, position 0
slowdown       `home` with hsd: the same with the SD switch
limit          `home` with jg alone: the limit switch, released again; the adapter sets that position to 0
here           `home` alone: no motion, the present position of the axis
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import floor

from adapters.ppsmc import fleetaxes, loading
from adapters.ppsmc.replies import ASK_POSITIONS, ASK_SETTINGS, ASK_STATUS, StatusBits, parse_settings
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Axis, Controller

_POLL_NS = 100 * NS_PER_MS
_READY_LAG_NS = 500 * NS_PER_MS  # ready bits may lag behind a start
_EXCLUSIVE_METHODS = ("default", "org", "ref", "index")  # not allowed while another axis moves


@dataclass(slots=True)
class _ReferenceSearch:
    """One axis that is searching for its reference.

    target: its final position, steps.
    stops: its number of stops before the search.
    begun_ns: when it began.
    seen: it has been seen moving, or its ready bit can no longer be that of the time before."""

    axis: str
    motor: int
    method: str
    command: str
    profile: tuple[int, int, int, int]
    target: int
    stops: int
    begun_ns: int = 0
    seen: bool = False

    @property
    def is_exclusive(self) -> bool:
        return self.method in _EXCLUSIVE_METHODS


async def home_axes(
    config: Controller, clock: Clock, unit: PpSmcState, axes: Sequence[str], found: Callable[[str], None]
) -> Mapping[str, Refusal]:
    """Find the references of `axes`; return those that failed. Raises `Refusal` when no axis began."""
    unit.require_enabled(axes)
    waiting = [_make_search(config, unit, name) for name in axes]
    failed: dict[str, Refusal] = {}
    running: list[_ReferenceSearch] = []
    async with unit.loading:
        look = await _prepare_searches(unit, waiting)
        for each in list(waiting):
            if each.method in ("default", "org", "ref") and look.bits[each.motor] & StatusBits.REFERENCED:
                waiting.remove(each)
                if each.motor in unit.spoiled:
                    failed[each.axis] = _installed_already(each)
                else:
                    found(each.axis)  # its reference is installed, and the command would not move it (L2333)
    if failed and not waiting and len(failed) == len(axes):
        raise next(iter(failed.values()))
    try:
        while waiting or running:
            for each in list(waiting):
                if not running or not (each.is_exclusive or running[0].is_exclusive):
                    waiting.remove(each)
                    await unit.start_motion(each.command, each.axis, each.motor, each.stops)
                    each.begun_ns = clock.now_ns()
                    running.append(each)
            await sleep_ns(clock, _POLL_NS)
            look = await unit.read_state()
            for each in _ended_searches(running, look, clock.now_ns(), lost=look.is_blocked or unit.session.restarted):
                why = await _search_failure(unit, each, look)
                if why == "" or clock.now_ns() > each.begun_ns + _READY_LAG_NS or unit.session.restarted:
                    running.remove(each)
                    if why:
                        text = f"axis {each.axis} has not found its reference: {why}"
                        failed[each.axis] = Refusal("homing-failed", text, "check its switches and `homing`")
                    else:
                        unit.spoiled.discard(each.motor)
                        found(each.axis)
    except BaseException:
        # After a cancellation nothing waits for the searching axes.
        with suppress(LinkClosed):
            unit.brake_axes(each.motor for each in running)
        raise
    return failed


def _ended_searches(
    running: Sequence[_ReferenceSearch], look: PpSmcReading, now_ns: int, *, lost: bool
) -> list[_ReferenceSearch]:
    """Return the searches whose axes read ready, or all that can no longer be followed.

    Before an axis has been seen moving, its ready bit and its reference may be those of an earlier search.
    """
    for each in running:
        each.seen |= not look.is_ready(each.motor) or now_ns > each.begun_ns + _READY_LAG_NS
    return [each for each in running if lost or (each.seen and look.is_ready(each.motor))]


async def _prepare_searches(unit: PpSmcState, searches: Sequence[_ReferenceSearch]) -> PpSmcReading:
    """Clear errors and load speeds, all while nothing moves. Raises `Refusal`."""
    reply = await unit.session.send_queries(ASK_STATUS, ASK_POSITIONS)
    look = unit.parse_state(reply.first_line(ASK_STATUS), reply.first_line(ASK_POSITIONS), reply.written_ns)
    if not look.is_idle:
        raise Refusal("moving", "an axis of the controller moves, or a program runs", "wait for its end, or stop it")
    commands = [f"cerr{each.motor}" for each in searches]
    for each in searches:
        commands += [f"{n}{each.motor}:{v}" for n, v in zip(loading.PROFILE, each.profile, strict=True)]
    held = parse_settings((await unit.session.send_once(commands, ASK_SETTINGS)).reply_texts(ASK_SETTINGS))
    for each in searches:
        loading.require_profile(each.axis, each.motor, each.profile, held)
        unit.profiles[each.motor] = each.profile
        unit.referenced.discard(each.motor)
    return look


def _make_search(config: Controller, unit: PpSmcState, name: str) -> _ReferenceSearch:
    axis = config.axes[name]
    motor, method, backwards = fleetaxes.axis_number(axis), axis.homing.method, axis.homing_sign < 0
    s, f, ramp, fine = _search_speeds(axis)
    sign = "-" if backwards else "+"
    jog = f"jg{'-' if backwards else ''}{f}"
    free = f"{'hr' if backwards else 'hm'}0;vl{fine}"
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
    return _ReferenceSearch(
        axis=name,
        motor=motor,
        method=method,
        command=commands[method],
        profile=(start, max(f, start), ramp, ramp),
        target=0 if at_zero else unit.homes.get(motor, 0),
        stops=unit.stops.stop_count(motor),
    )


def _search_speeds(axis: Axis) -> tuple[int, int, int, int]:
    """Return start speed, approach speed (steps/s), ramp (Hz/ms), and the speed of the fine search."""
    limits, homing, scale = fleetaxes.axis_bounds(axis), axis.homing, float(axis.scale)
    f = floor((homing.speed if homing.speed is not None else axis.limits.velocity / 10) * scale)
    f = max(1, limits.start_min, min(f, floor(limits.speed)))
    highest = max(limits.start_min, min(limits.start_max, f))
    if limits.ramp_max < 1:
        f = highest  # it cannot accelerate as gently as required, and so runs at its start speed
    fine = highest
    if homing.search_speed is not None:
        fine = max(limits.start_min, min(highest, floor(homing.search_speed * scale)))
    return highest, f, max(1, limits.ramp_max), fine


async def _search_failure(unit: PpSmcState, search: _ReferenceSearch, look: PpSmcReading) -> str:
    """Return the failure of a search whose axis is at rest; "" when it has found its reference."""
    motor, bits = search.motor, look.bits[search.motor]
    if unit.session.restarted:
        return "the controller was restarted"
    if unit.stops.stop_count(motor) != search.stops or look.is_blocked:
        return "it was stopped"
    try:
        number, text = (await unit.read_errors()).get(motor, (0, ""))
    except ControllerFault:
        return "the controller did not report how it ended"
    if number:
        return f"the controller reports error {number} {text}".rstrip()
    if search.method == "limit":
        if not _limit_was_reached(search, look):
            return "it has not moved"
        return await _set_zero(unit, search)
    if not bits & (StatusBits.REFERENCED if search.method != "index" else 1 << 10):
        return "no reference is installed"
    if look.counts[motor] != search.target:
        return f"it is at {look.counts[motor]} steps, not at {search.target}"
    return ""


def _limit_was_reached(search: _ReferenceSearch, look: PpSmcReading) -> bool:
    """Return whether the axis has left the switch again: that is where `jg` ends (L2062)."""
    return not look.bits[search.motor] & (StatusBits.LIMIT_FORWARD | StatusBits.LIMIT_REVERSE)


async def _set_zero(unit: PpSmcState, search: _ReferenceSearch) -> str:
    async with unit.loading:
        reply = await unit.session.send_once((f"pos{search.motor}:0",), ASK_STATUS, ASK_POSITIONS)
    look = unit.parse_state(reply.first_line(ASK_STATUS), reply.first_line(ASK_POSITIONS), reply.written_ns)
    return "" if look.counts[search.motor] == 0 else "its position could not be set: another axis moves"


def _installed_already(search: _ReferenceSearch) -> Refusal:
    return Refusal(
        "already-referenced",
        f"axis {search.axis} was stopped by a limit switch, but the controller reports its reference as "
        f"installed, and `{search.command}` moves nothing then",
        "use homing method switch or limit, or switch the controller off and on",
    )
