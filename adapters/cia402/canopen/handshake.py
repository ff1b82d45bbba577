"""The handshake of profile position mode: bit 4 of the controlword gives a set-point, bit 12 of the statusword
acknowledges it.

A bit that stood before an order is never the answer to it. So bit 12 must be off before a set-point is given.
"""

from adapters.cia402.canopen import states
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import TARGET
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal

_FALL_NS = 20 * NS_PER_MS  # within this time a drive takes the bit back, once bit 4 is off
_HELD_NS = 20 * NS_PER_MS  # bit 4 is shown to the drive for so long: several of its cycles
STANDING_NS = _FALL_NS + _HELD_NS + _FALL_NS
"""Longest time of `settle_handshake` beyond its exchanges, for a drive whose bit stands."""


async def settle_handshake(node: BusDrive, stops: int) -> None:
    """Wait until bit 12 is off; bit 4 is off, and the drive is enabled in profile position mode and at rest.

    Some drives show the bit from their enabling, or from the change of mode, until a set-point was given and taken
    back. Such a drive is given its present position, which moves nothing. stops: number of stops at the time of the
    request; after a further one nothing is given. Raises `Refusal` (not-taken, stopped), `ControllerFault`.
    """

    def is_open() -> bool:
        return not node.status & states.ACKNOWLEDGED

    def is_interrupted() -> bool:
        return node.stops != stops or not node.is_enabled

    async def wait_until_open(patience_ns: int) -> bool:
        await node.wait_until(lambda: is_open() or is_interrupted(), node.clock.now_ns() + patience_ns)
        _require_undisturbed(node, stops)
        return is_open()

    if await wait_until_open(_FALL_NS):
        return
    node.stands_acknowledged = True
    node.log.info(
        "the set-point acknowledge stands without a set-point; it is taken back by one at the present position"
    )
    node.give_position(node.demand)
    await node.sdo.write_value(TARGET, node.demand)
    _require_undisturbed(node, stops)
    node.send_control(states.ENABLE | states.NEW_SET_POINT | states.AT_ONCE)
    await node.wait_until(is_interrupted, node.clock.now_ns() + _HELD_NS)
    _require_undisturbed(node, stops)
    node.send_control(states.ENABLE)
    if await wait_until_open(_FALL_NS):
        return
    await node.query_status()
    if not is_open():
        raise standing_refusal(node)


def standing_refusal(node: BusDrive) -> Refusal:
    """Return the refusal for a drive whose acknowledge would be taken for the answer to the next set-point."""
    return Refusal(
        "not-taken",
        f"{node.name} shows a set-point acknowledge (bit 12 of its statusword, {node.status:04x}h) without a "
        "set-point, so that it cannot acknowledge the next one",
        "disable and enable it; is another master on the bus?",
    )


def _require_undisturbed(node: BusDrive, stops: int) -> None:
    if node.stops != stops:
        raise Refusal("stopped", f"a stop came before {node.name} was given its set-point", "")
    if not node.is_enabled:
        raise Refusal("not-enabled", f"{node.name} is {node.state.value}", "enable it first")
