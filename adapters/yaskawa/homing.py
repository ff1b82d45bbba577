"""Finding the reference: by the home switch and the index, by the switch alone, or by the index alone.

    default  HM: to the edge of the home switch, slowly back over it, then to the index; position 0 there (L14199)
    edge     FE: to the edge of the home switch, decelerating past it; position 0 where it stands (L5168)
    index    FI: to the next index pulse at low speed; position 0 there (L5219)

HM and FE take their direction from the level of the home input (L5586), so that they find the switch from either
side; only FI goes in the direction of the fleet file.
"""

from collections.abc import Mapping, Sequence

from adapters.contract import CannotDo
from adapters.yaskawa.device import Device
from adapters.yaskawa.record import AXIS_LETTERS
from adapters.yaskawa.trapezoid import RAMP_MAX, RAMP_STEP, RAMP_UNIT, SPEED_MAX, SPEED_STEP, SPEED_UNIT
from adapters.yaskawa.words import stop_words
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.model.fleet import Axis

METHODS = {"default": "HM", "edge": "FE", "index": "FI"}
FOUND = {"HM": (10,), "FE": (9,), "FI": (10, 9)}  # FI has no stop code of its own (L9858-9899)
INDEX_SPEED_MAX = 1000.0  # counts/s; recommended for FI (L5224)
SPEED_OF_LIMIT = 0.1
LOOK_NS = 50 * NS_PER_MS


def speed_register(counts_s: float, tick_s: float) -> int:
    """SP or JG for a speed in host time."""
    return max(SPEED_STEP, min(SPEED_MAX, int(counts_s * tick_s * SPEED_UNIT // SPEED_STEP) * SPEED_STEP))


def ramp_register(counts_s2: float, tick_s: float) -> int:
    """AC or DC for an acceleration in host time."""
    return max(RAMP_STEP, min(RAMP_MAX, int(counts_s2 * tick_s**2 * RAMP_UNIT // RAMP_STEP) * RAMP_STEP))


async def home(device: Device, clock: Clock, axes: Sequence[tuple[str, int, Axis]]) -> Mapping[str, CannotDo]:
    """Home `axes` (name, index, configuration) at the same time; gives those that have not succeeded, and why."""
    session, tick_s = device.session, device.samples.tick_ns * 1e-9
    commands = {name: METHODS[axis.homing.method] for name, _, axis in axes}
    for name, index, axis in axes:
        letter, scale, command = AXIS_LETTERS[index], float(axis.scale), commands[name]
        speed = (axis.homing.speed or SPEED_OF_LIMIT * axis.limits.velocity) * scale
        ramp = ramp_register(axis.limits.acceleration * scale, tick_s)
        await session.tell(f"AC{letter}={ramp}")
        await session.tell(f"DC{letter}={ramp}")
        if command == "FI":
            search = axis.homing.search_speed * scale if axis.homing.search_speed else min(speed, INDEX_SPEED_MAX)
            # The direction is meant in the axis's unit; the controller may count the other way.
            sign = axis.sign if axis.homing.direction == "positive" else -axis.sign
            await session.tell(f"JG{letter}={sign * speed_register(search, tick_s)}")
        else:
            await session.tell(f"SP{letter}={speed_register(speed, tick_s)}")
        await session.tell(f"{command}{letter}")
    await session.tell("BG" + "".join(AXIS_LETTERS[index] for _, index, _ in axes))
    while True:
        record = await device.record()
        if not any(record.axes[index].moving for _, index, _ in axes):
            break
        await sleep_ns(clock, LOOK_NS)
    failed: dict[str, CannotDo] = {}
    for name, index, _ in axes:
        number = record.axes[index].stop_code
        if number not in FOUND[commands[name]]:
            stop = stop_words(number)
            failed[name] = CannotDo(
                "homing-failed", f"axis {name}: homing {stop.text}", stop.remedy or "look at its switches"
            )
        elif commands[name] == "FE":
            await session.tell(f"DP{AXIS_LETTERS[index]}=0")
    return failed
