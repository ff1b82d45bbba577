"""The set-point and the commanded position of a drive: by PDO where one carries them, by SDO, or concluded."""

from collections.abc import Mapping

from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import (
    ACCELERATION,
    DECELERATION,
    DEMAND,
    MODE_DISPLAY,
    PROFILE_VELOCITY,
    TARGET,
    DictionaryObject,
)
from orchestrator.link.can import CanFrame

_MODE_READS = 3  # of an arming, until the mode is shown
_RAMPS = frozenset({ACCELERATION, DECELERATION})


def make_set_point(
    node: BusDrive, target: int, velocity: int, acceleration: int, deceleration: int
) -> dict[DictionaryObject, int]:
    """Return the objects of a set-point with their values, all in the drive's units."""
    values = {TARGET: target, PROFILE_VELOCITY: velocity, ACCELERATION: acceleration}
    return values if node.has_equal_ramps else {**values, DECELERATION: deceleration}


async def load_set_point(node: BusDrive, values: Mapping[DictionaryObject, int]) -> None:
    """Load a target with its profile; a controlword starts the motion. Raises like `SdoClient.write_value`."""
    pdos = node.layout.find_loading(values)
    pdo_objects = {obj for pdo in pdos for obj in pdo.carries}
    for obj, value in values.items():
        if obj not in pdo_objects:
            await node.sdo.write_value(obj, value)
    if node.followed is not None:
        node.give_position(values[TARGET])
    node.bus.send_frames(*(CanFrame(pdo.function + node.number, pdo.encode(values)) for pdo in pdos))


def count_accesses(node: BusDrive) -> int:
    """Return how many SDOs an arming takes in place of PDOs; none, until these are known."""
    if not node.layout.pdos:
        return 0
    values = make_set_point(node, 0, 0, 0, 0)
    pdo_objects = {obj for pdo in node.layout.find_loading(values) for obj in pdo.carries}
    if node.followed is not None:
        pdo_objects |= _RAMPS  # streams need none, and RPDO 4 carries positions
    return len(values.keys() - pdo_objects) + _MODE_READS * (MODE_DISPLAY not in node.layout.reported)


def begin_motion(node: BusDrive, target: int) -> None:
    """Record that a drive has begun a motion to `target`."""
    node.commanded.begin_motion(target)
    _conclude_demand(node)


async def rest_here(node: BusDrive) -> None:
    """Record that a drive was stopped, and has come to rest, once its last position has arrived."""
    if DEMAND not in node.layout.reported:
        await node.wait_until(lambda: False, node.clock.now_ns() + 2 * node.inhibit_ns)
        node.commanded.rest_at(node.actual)
        _conclude_demand(node)


def _conclude_demand(node: BusDrive) -> None:
    if DEMAND not in node.layout.reported:
        node.demand = node.commanded.estimate(node.actual)
