"""Homing: by the home switch and the index, by the switch alone, or by the index alone.

    default  HM: to the edge of the home switch, slowly back over it, then to the index; position 0 there (L14199)
    edge     FE: to the edge of the home switch, decelerating past it; position 0 where the axis stops (L5168)
    index    FI: to the next index pulse at low speed; position 0 there (L5219)

HM and FE take their direction from the level of the home input (L5586), so that they find the switch from either side;
only FI uses the direction of the fleet file. A limit switch on the path stops the axis (L16558), and so would FL and
BL: they must be off, because the position is unknown during homing.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.registers import ramp_register, speed_register
from adapters.yaskawa.language.words import stop_code_meaning
from adapters.yaskawa.shapes.model import SMC4000
from adapters.yaskawa.wire.record import AXIS_LETTERS, AxisRecord
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis

METHODS = {"default": "HM", "edge": "FE", "index": "FI"}
FOUND = {"HM": (10,), "FE": (9,), "FI": (10, 9)}  # FI has no stop code of its own (L9858-9899)
INDEX_SPEED_MAX = 1000.0  # counts/s; recommended for FI (L5224)
SPEED_OF_LIMIT = 0.1
POLL_NS = 50 * NS_PER_MS

HomingAxis = tuple[str, int, Axis]
"""Name, index and configuration of an axis."""


async def home_axes(
    device: SmcDevice, clock: Clock, axes: Sequence[HomingAxis], found: Callable[[str], None]
) -> Mapping[str, Refusal]:
    """Home `axes` at the same time, independently of each other. Report each success at once; return the other axes
    with the reasons.

    Raises `Refusal` when no axis began.
    """
    stop_counts = {index: device.stop_counts.stop_count(index) for _, index, _ in axes}
    searching: list[HomingAxis] = []
    try:
        failures = await _begin_homing(device, axes, stop_counts, searching)
        while searching:
            # A search begins at a sample after BG: until then the axis rests with the stop code of an earlier search.
            await sleep_ns(clock, POLL_NS)
            record = await device.read_record()
            for homing_axis in [homing_axis for homing_axis in searching if not record.axes[homing_axis[1]].is_moving]:
                searching.remove(homing_axis)
                error = await _homing_failure(device, homing_axis, record.axes[homing_axis[1]])
                if error is None:
                    found(homing_axis[0])
                else:
                    failures[homing_axis[0]] = error
    except BaseException:
        # After a cancellation the searching axes would continue without supervision.
        with suppress(LinkClosed):
            device.brake_axes(index for _, index, _ in searching)
        raise
    return failures


async def _begin_homing(
    device: SmcDevice, axes: Sequence[HomingAxis], since: Mapping[int, int], begun: list[HomingAxis]
) -> dict[str, Refusal]:
    """Begin homing where possible; return the other axes. Raises `Refusal` when no axis began."""
    record = await device.read_record()
    failures: dict[str, Refusal] = {}
    for homing_axis in axes:
        name, index, axis = homing_axis
        try:
            require_at_rest(name, record.axes[index])
            await _load_homing(device, index, axis)
            await device.begin_motion(name, index, since[index])
        except Refusal as error:
            failures[name] = error
        else:
            begun.append(homing_axis)
    if axes and not begun:
        first = next(iter(failures.values()))
        raise Refusal(first.code, "; ".join(str(error) for error in failures.values()), first.remedy)
    return failures


async def _homing_failure(device: SmcDevice, searched: HomingAxis, now: AxisRecord) -> Refusal | None:
    """Return the failure of an axis that has come to rest; None if it has found its reference and is at position 0."""
    name, index, axis = searched
    command = METHODS[axis.homing.method]
    if now.stop_code not in FOUND[command]:
        stop = stop_code_meaning(now.stop_code)
        return Refusal("homing-failed", f"axis {name}: homing {stop.text}", stop.remedy or "check its switches")
    if command == "FE":
        await device.session.send_command(f"DP{AXIS_LETTERS[index]}=0")
    return None


def require_at_rest(name: str, now: AxisRecord) -> None:
    """Raise `Refusal` for an axis that moves or is not enabled."""
    if now.is_moving:
        raise Refusal("moving", f"axis {name} is moving", "wait for its end, or stop it")
    if not now.is_enabled:
        raise Refusal("not-enabled", f"axis {name} is not enabled", f"enable {name} first")


async def _load_homing(device: SmcDevice, index: int, axis: Axis) -> None:
    """Load speeds, ramps and the homing method of one axis. Values below the controller's minimum are raised to it."""
    session, tick_s = device.session, device.samples.tick_ns * 1e-9
    letter, scale, command = AXIS_LETTERS[index], float(axis.scale), METHODS[axis.homing.method]
    speed = (axis.homing.speed or SPEED_OF_LIMIT * axis.limits.velocity) * scale
    ramp = max(SMC4000.ramp_step, ramp_register(axis.limits.acceleration * scale, tick_s))
    await session.send_command(f"AC{letter}={ramp}")
    await session.send_command(f"DC{letter}={ramp}")
    if command == "FI":
        search = axis.homing.search_speed * scale if axis.homing.search_speed else min(speed, INDEX_SPEED_MAX)
        await session.send_command(
            f"JG{letter}={axis.homing_sign * max(SMC4000.speed_step, speed_register(search, tick_s))}"
        )
    else:
        await session.send_command(f"SP{letter}={max(SMC4000.speed_step, speed_register(speed, tick_s))}")
    await session.send_command(f"{command}{letter}")
