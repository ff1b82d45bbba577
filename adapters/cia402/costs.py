"""Upper bounds of arming, disarming and stopping, on a bus whose drives do the same at the same time."""

from math import ceil

from adapters.cia402.canopen.bus import SYNC
from adapters.cia402.canopen.objects import DEMAND, OUTPUTS, STATUSWORD, TARGET
from adapters.cia402.options import Cia402Options
from adapters.cia402.sync.stream import COPIES
from adapters.contract import DriverCapabilities
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.link.can import CanFrame, frame_ns
from orchestrator.model.state import ChunkTriggers, StepCosts

_FULL = CanFrame(0x7FF, bytes(8))
_READS, _ORDERS = 4, 5  # of arming: SDOs with verification; mode, target, profile, and the drive's state
LONGEST_CHUNK_S, LOAD_S = 60.0, 0.1  # nothing is loaded ahead in the drive
CHUNK_TRIGGERS = 20_000  # nothing is stored in the drive
RETARGET_PERIODS = 10  # those that are sent ahead, and some for the request
_STOP_FRAMES = 3  # what waits for a SYNC, both controlword and position, and the controlword that counts at once
_HOST_NS = 2 * NS_PER_MS  # event loop and operating system, both ways
_HANDLED_NS = 5 * NS_PER_MS  # usual time of an SDO server to answer


def full_frame_ns(bitrate: int) -> int:
    """Return the duration of the longest frame on the bus."""
    return frame_ns(_FULL, bitrate)


def sync_ns(bitrate: int) -> int:
    """Return the duration of the SYNC on the bus."""
    return frame_ns(SYNC, bitrate)


def stream_ns(bitrate: int, drives: int, switching: int = 0) -> int:
    """Return the bus time that one period of a position stream takes. switching: drives whose outputs travel with their
    positions."""
    position, answer = (
        CanFrame(0x7FF, bytes(TARGET.byte_size)),
        CanFrame(0x7FF, bytes(STATUSWORD.byte_size + DEMAND.byte_size)),
    )
    longer_ns = frame_ns(CanFrame(0x7FF, bytes(TARGET.byte_size + OUTPUTS.byte_size)), bitrate)
    position_ns = frame_ns(position, bitrate)
    positions_ns = COPIES * ((drives - switching) * position_ns + switching * longer_ns)
    return sync_ns(bitrate) + positions_ns + drives * frame_ns(answer, bitrate)


def step_costs(options: Cia402Options, bitrate: int, drives: int, ramp_s: float, watched: int = 0) -> StepCosts:
    """Return upper bounds in ns.

    ramp_s: the longest ramp of the motion that may have to be stopped. watched: number of settings that are read before
    arming, and of objects that it reads and writes besides.
    """
    each_ns = full_frame_ns(bitrate) * drives
    way_ns = options.wire_jitter_us * NS_PER_US + _HOST_NS
    cycle_ns = (options.cycle_us + options.start_us + options.start_spread_us) * NS_PER_US
    exchange_ns = 2 * each_ns + 2 * way_ns + _HANDLED_NS
    said_ns = 2 * way_ns + cycle_ns + options.inhibit_ms * NS_PER_MS
    return StepCosts(
        arm_ns=(_READS + watched) * exchange_ns + _ORDERS * each_ns + said_ns,
        disarm_ns=_STOP_FRAMES * each_ns + 2 * way_ns + cycle_ns,
        stop_ns=_STOP_FRAMES * each_ns + way_ns + cycle_ns + 2 * NS_PER_MS + ceil(ramp_s * NS_PER_S),
    )


def make_capabilities(costs: StepCosts, period_ms: int | None, watchdog_ms: int | None) -> DriverCapabilities:
    """What a drive supports. period_ms: of the positions that it follows; None: it follows none. watchdog_ms: after
    which it stops without this computer; None: it does not."""
    alone_s = None if watchdog_ms is None else watchdog_ms / 1000
    if period_ms is None:
        return DriverCapabilities(
            start_classes=("sync",),
            orders=(2,),
            independent_axes=False,
            costs=costs,
            jog_ramps=True,
            shows_inputs=True,
            alone_s=alone_s,
        )
    return DriverCapabilities(
        start_classes=("sync",),
        orders=(2, 3),
        independent_axes=False,
        costs=costs,
        chunk_s=LONGEST_CHUNK_S,
        chunk_load_s=LOAD_S,
        chunk_triggers=ChunkTriggers(most=CHUNK_TRIGGERS, shows=True),
        retarget_s=RETARGET_PERIODS * period_ms / 1000,
        jog_ramps=True,
        shows_inputs=True,
        alone_s=alone_s,
    )
