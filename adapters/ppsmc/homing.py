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
    pending_searches = [_make_search(config, unit, name) for name in axes]
    failures: dict[str, Refusal] = {}
    begun_searches: list[_ReferenceSearch] = []
    async with unit.loading:
        look = await _prepare_searches(unit, pending_searches)
        for search in list(pending_searches):
            if search.method in ("default", "org", "ref") and look.bits[search.motor] & StatusBits.REFERENCED:
                pending_searches.remove(search)
                if search.motor in unit.spoiled:
                    failures[search.axis] = _installed_already(search)
                else:
                    found(search.axis)  # its reference is installed, and the command would not move it (L2333)
    if failures and not pending_searches and len(failures) == len(axes):
        raise next(iter(failures.values()))
    try:
        while pending_searches or begun_searches:
            for search in list(pending_searches):
                if not begun_searches or not (search.is_exclusive or begun_searches[0].is_exclusive):
                    pending_searches.remove(search)
                    await unit.start_motion(search.command, search.axis, search.motor, search.stops)
                    search.begun_ns = clock.now_ns()
                    begun_searches.append(search)
            await sleep_ns(clock, _POLL_NS)
            look = await unit.read_state()
            for search in _ended_searches(
                begun_searches, look, clock.now_ns(), lost=look.is_blocked or unit.session.batches.restarted
            ):
                failure = await _search_failure(unit, search, look)
                if failure == "" or clock.now_ns() > search.begun_ns + _READY_LAG_NS or unit.session.batches.restarted:
                    begun_searches.remove(search)
                    if failure:
                        text = f"axis {search.axis} has not found its reference: {failure}"
                        failures[search.axis] = Refusal("homing-failed", text, "check its switches and `homing`")
                    else:
                        unit.spoiled.discard(search.motor)
                        found(search.axis)
    except BaseException:
        # After a cancellation nothing waits for the searching axes.
        with suppress(LinkClosed):
            unit.brake_axes(search.motor for search in begun_searches)
        raise
    return failures


def _ended_searches(
    running: Sequence[_ReferenceSearch], look: PpSmcReading, now_ns: int, *, lost: bool
) -> list[_ReferenceSearch]:
    """Return the searches whose axes read ready, or all that can no longer be followed.

    Before an axis has been seen moving, its ready bit and its reference may be those of an earlier search.
    """
    for search in running:
        search.seen |= not look.is_ready(search.motor) or now_ns > search.begun_ns + _READY_LAG_NS
    return [search for search in running if lost or (search.seen and look.is_ready(search.motor))]


async def _prepare_searches(unit: PpSmcState, searches: Sequence[_ReferenceSearch]) -> PpSmcReading:
    """Clear errors and load speeds, all while nothing moves. Raises `Refusal`."""
    reply = await unit.session.send_queries(ASK_STATUS, ASK_POSITIONS)
    look = unit.parse_state(reply.first_line(ASK_STATUS), reply.first_line(ASK_POSITIONS), reply.written_ns)
    if not look.is_idle:
        raise Refusal("moving", "an axis of the controller moves, or a program runs", "wait for its end, or stop it")
    commands = [f"cerr{search.motor}" for search in searches]
    for search in searches:
        commands += [f"{n}{search.motor}:{v}" for n, v in zip(loading.PROFILE, search.profile, strict=True)]
    held_settings = parse_settings((await unit.session.send_once(commands, ASK_SETTINGS)).reply_texts(ASK_SETTINGS))
    for search in searches:
        loading.require_profile(search.axis, search.motor, search.profile, held_settings)
        unit.profiles[search.motor] = search.profile
        unit.referenced.discard(search.motor)
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
    if unit.session.batches.restarted:
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
        "send it `reset` as a raw command, or switch it off and on: it forgets the references of all its axes; then "
        "home them. Homing methods switch and limit need neither",
    )
