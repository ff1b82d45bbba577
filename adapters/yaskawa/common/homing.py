"""Finding the reference: by the home switch and the index, by the switch alone, or by the index alone.

    default  HM: to the edge of the home switch, slowly back over it, then to the index; position 0 there (L14199)
    edge     FE: to the edge of the home switch, decelerating past it; position 0 where it stands (L5168)
    index    FI: to the next index pulse at low speed; position 0 there (L5219)

HM and FE take their direction from the level of the home input (L5586), so that they find the switch from either
side; only FI goes in the direction of the fleet file. A limit switch on the way stops the axis (L16558), and so would
FL and BL: they must be off, because an axis that looks for its reference does not know where it is.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from adapters.contract import CannotDo
from adapters.yaskawa.common.model import SMC4000
from adapters.yaskawa.common.record import AXIS_LETTERS, AxisRecord
from adapters.yaskawa.common.registers import ramp_register, speed_register
from adapters.yaskawa.common.words import stop_words
from adapters.yaskawa.smc4000.device import Device
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Axis

METHODS = {"default": "HM", "edge": "FE", "index": "FI"}
FOUND = {"HM": (10,), "FE": (9,), "FI": (10, 9)}  # FI has no stop code of its own (L9858-9899)
INDEX_SPEED_MAX = 1000.0  # counts/s; recommended for FI (L5224)
SPEED_OF_LIMIT = 0.1
LOOK_NS = 50 * NS_PER_MS

Searched = tuple[str, int, Axis]
"""Name, index and configuration of an axis."""


async def home(
    device: Device, clock: Clock, axes: Sequence[Searched], found: Callable[[str], None]
) -> Mapping[str, CannotDo]:
    """Home `axes` at the same time, each for itself. Says at once which has succeeded; gives the others, and why.

    Raises `CannotDo` when none was begun.
    """
    since = {index: device.stops_given(index) for _, index, _ in axes}
    searching: list[Searched] = []
    try:
        failed = await _begin(device, axes, since, searching)
        while searching:
            record = await device.record()
            for each in [each for each in searching if not record.axes[each[1]].moving]:
                searching.remove(each)
                error = await _judged(device, each, record.axes[each[1]])
                if error is None:
                    found(each[0])
                else:
                    failed[each[0]] = error
            if searching:
                await sleep_ns(clock, LOOK_NS)
    except BaseException:
        # Nobody waits any more for those that look for it.
        with suppress(LinkClosed):
            device.brake(index for _, index, _ in searching)
        raise
    return failed


async def _begin(
    device: Device, axes: Sequence[Searched], since: Mapping[int, int], begun: list[Searched]
) -> dict[str, CannotDo]:
    """Set going what can be; gives the others. Raises `CannotDo` when that is all of them."""
    record = await device.record()
    failed: dict[str, CannotDo] = {}
    for each in axes:
        name, index, axis = each
        try:
            _require_ready(name, record.axes[index])
            await _load(device, index, axis)
            await device.begin(name, index, since[index])
        except CannotDo as error:
            failed[name] = error
        else:
            begun.append(each)
    if axes and not begun:
        first = next(iter(failed.values())).refusal
        raise CannotDo(first.code, "; ".join(str(error) for error in failed.values()), first.remedy)
    return failed


async def _judged(device: Device, searched: Searched, now: AxisRecord) -> CannotDo | None:
    """What has become of an axis that has come to rest; None: it has found its reference, and is 0 there."""
    name, index, axis = searched
    command = METHODS[axis.homing.method]
    if now.stop_code not in FOUND[command]:
        stop = stop_words(now.stop_code)
        return CannotDo("homing-failed", f"axis {name}: homing {stop.text}", stop.remedy or "look at its switches")
    if command == "FE":
        await device.session.tell(f"DP{AXIS_LETTERS[index]}=0")
    return None


def _require_ready(name: str, now: AxisRecord) -> None:
    if now.moving:
        raise CannotDo("moving", f"axis {name} is moving", "wait, or stop it")
    if not now.enabled:
        raise CannotDo("not-enabled", f"axis {name} is not enabled", f"enable {name} first")


async def _load(device: Device, index: int, axis: Axis) -> None:
    """Speeds, ramps and the method of one axis. What is too slow for the controller is done as slowly as it can."""
    session, tick_s = device.session, device.samples.tick_ns * 1e-9
    letter, scale, command = AXIS_LETTERS[index], float(axis.scale), METHODS[axis.homing.method]
    speed = (axis.homing.speed or SPEED_OF_LIMIT * axis.limits.velocity) * scale
    ramp = max(SMC4000.ramp_step, ramp_register(axis.limits.acceleration * scale, tick_s))
    await session.tell(f"AC{letter}={ramp}")
    await session.tell(f"DC{letter}={ramp}")
    if command == "FI":
        search = axis.homing.search_speed * scale if axis.homing.search_speed else min(speed, INDEX_SPEED_MAX)
        # The direction is meant in the axis's unit; the controller may count the other way.
        sign = axis.sign if axis.homing.direction == "positive" else -axis.sign
        await session.tell(f"JG{letter}={sign * max(SMC4000.speed_step, speed_register(search, tick_s))}")
    else:
        await session.tell(f"SP{letter}={max(SMC4000.speed_step, speed_register(speed, tick_s))}")
    await session.tell(f"{command}{letter}")
