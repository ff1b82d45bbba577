"""What exists only while a drive is connected."""

from contextlib import suppress
from dataclasses import dataclass

from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import CONSUMER
from adapters.cia402.fleetaxes import drive_units, only_axis, passive_outputs, ramp_in_units
from adapters.cia402.hand import Cia402ManualMotion
from adapters.cia402.manual_outputs import ManualOutputs
from adapters.cia402.moves import Cia402Mover, EndLimits
from adapters.cia402.options import Cia402Options
from adapters.cia402.power import PowerStage
from adapters.cia402.reading import DriveReader
from adapters.cia402.sync.starts import SyncScheduler
from adapters.cia402.watch import SettingsWatch
from orchestrator.clock.base import NS_PER_S
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller


@dataclass(frozen=True, slots=True)
class Cia402Connection:
    """Everything that exists only while the drive is connected."""

    node: BusDrive
    power: PowerStage
    mover: Cia402Mover
    manual: Cia402ManualMotion
    reader: DriveReader
    outputs: ManualOutputs
    watch: SettingsWatch

    async def end_operation(self, *, watched: bool) -> None:
        """End what the drive does at the end of a connection. watched: the drive monitors this computer's heartbeat."""
        with suppress(ControllerFault, LinkClosed):
            await self.mover.halt_drive()
            if watched and self.node.mapped:
                await self.node.sdo.write_value(CONSUMER, 0)


def make_connection(
    config: Controller, options: Cia402Options, node: BusDrive, sync_scheduler: SyncScheduler
) -> Cia402Connection:
    """Return the parts of a connection; nothing is sent to the drive."""
    name, axis = only_axis(config)
    power = PowerStage(node, passive_outputs(config))
    limits = EndLimits(round(axis.in_position_timeout_s * NS_PER_S), ramp_in_units(axis, drive_units(options)))
    mover = Cia402Mover(options, sync_scheduler, node, power, limits)
    manual = Cia402ManualMotion(config, options, node, power, lambda: mover.move is not None)
    mover.busy = lambda: manual.homing or manual.is_jogging
    return Cia402Connection(
        node=node,
        power=power,
        mover=mover,
        manual=manual,
        reader=DriveReader(options, node, power, mover, name),
        outputs=ManualOutputs(options, node, mover),
        watch=SettingsWatch(node, name),
    )
