"""The mode of operation of a drive: sent by itself, or read by SDO where no PDO carries it."""

from collections.abc import Callable

from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import MODE_DISPLAY
from orchestrator.clock.base import NS_PER_MS

_READ_NS = 5 * NS_PER_MS  # from one reading to the next


async def refresh_mode(node: BusDrive) -> None:
    """Read its mode of operation, unless it sends it by itself. Raises like `SdoClient.read_value`."""
    if MODE_DISPLAY not in node.layout.reported:
        node.mode = await node.sdo.read_value(MODE_DISPLAY)


async def wait_for_mode(node: BusDrive, mode: int, ready: Callable[[], bool] = lambda: True) -> bool:
    """Wait briefly until it shows `mode` and is `ready`, or is not enabled; return whether it shows all of that."""

    def is_shown() -> bool:
        return node.mode == mode and ready()

    until_ns = node.clock.now_ns() + node.answer_ns
    step_ns = node.answer_ns if MODE_DISPLAY in node.layout.reported else _READ_NS
    while True:
        await refresh_mode(node)
        await node.wait_until(lambda: is_shown() or not node.is_enabled, min(until_ns, node.clock.now_ns() + step_ns))
        if is_shown() or not node.is_enabled or node.clock.now_ns() >= until_ns:
            return is_shown() and node.is_enabled
