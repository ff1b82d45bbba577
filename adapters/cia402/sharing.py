"""What the drives of one bus share: the bus itself, its SYNCs, and what all of them must agree on."""

from adapters.cia402.canopen.bus import SHARED, Cia402Bus
from adapters.cia402.fleetaxes import needs_stream, node_number
from adapters.cia402.options import Cia402Options
from adapters.cia402.sync.starts import SyncScheduler
from adapters.contract import DriverSetup
from orchestrator.clock.base import NS_PER_US
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import CanBusLink

_STARTS = "cia402 starts"


def join_bus(setup: DriverSetup, options: Cia402Options) -> tuple[Cia402Bus, SyncScheduler]:
    """Return the bus of the drive and its starts; the drive is known to both, and nothing is opened."""
    config, link = setup.config, setup.config.link
    assert isinstance(link, CanBusLink)
    number = node_number(config)
    bus: Cia402Bus = setup.shared.setdefault(SHARED, Cia402Bus(setup.clock, link.bitrate))
    bus.register_drive(number, options.start_us * NS_PER_US)
    sync_scheduler: SyncScheduler = setup.shared.setdefault(_STARTS, SyncScheduler(bus, setup.timed_writer))
    sync_scheduler.mark_unknown(number)
    if needs_stream(config):
        bus.periods_ms[number] = options.period_ms
        if config.outputs:
            bus.switching.add(number)
    if options.watchdog_ms is not None:
        bus.watchdogs_ms[number] = options.watchdog_ms
        bus.host_node = options.host_node
    return bus, sync_scheduler


def compare_bus(bus: Cia402Bus, link: CanBusLink) -> None:
    """Compare what the drives of one bus must have in common. Raises `ControllerFault`."""
    if bus.bitrate != link.bitrate:
        raise ControllerFault(
            "config-mismatch",
            f"{link.endpoint}: the drives of one bus have different values of link.bitrate",
            "set the same value for all of them",
        )
    if bus.host_node in bus.units:
        raise ControllerFault(
            "config-mismatch",
            f"{link.endpoint}: a drive has the node number {bus.host_node} of this computer's heartbeat",
            "set another node number of this computer with `options.host_node`",
        )
    if len(set(bus.periods_ms.values())) > 1:
        raise ControllerFault(
            "config-mismatch",
            f"{link.endpoint}: the drives of one bus have different values of options.period_ms, and "
            "one SYNC serves all",
            "set the same value for all of them",
        )
