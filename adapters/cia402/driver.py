"""The driver of one CiA 402 drive."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from adapters.abilities import (
    LatchDriver,
    LimitDriver,
    ManualDriver,
    OutputDriver,
    PathDriver,
    ProbeDriver,
    RetargetDriver,
    SamplingDriver,
    SettingsDriver,
    SharedLineDriver,
    ShownTriggerDriver,
)
from adapters.cia402 import sharing, startup
from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.commanded import CommandedPosition
from adapters.cia402.canopen.handshake import STANDING_NS
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import CYCLIC_MODE, FOLLOWED, DictionaryObject
from adapters.cia402.canopen.sdo import bus_off_fault
from adapters.cia402.canopen.setpoint import count_accesses
from adapters.cia402.canopen.touch_probe import TouchProbe, find_edge
from adapters.cia402.connection import Cia402Connection, make_connection
from adapters.cia402.costs import make_capabilities, step_costs
from adapters.cia402.fleetaxes import (
    needs_stream,
    node_number,
    only_axis,
    ramp_s,
)
from adapters.cia402.lowering import BusTimes, Cia402Lowered, ConnectionTraits, lower_step
from adapters.cia402.mapping.transfer import PdoMapper
from adapters.cia402.needs import make_pdo_needs
from adapters.cia402.options import Cia402Options
from adapters.cia402.probe_motion import ProbeMotion, find_ability
from adapters.cia402.sampling import PdoSampling
from adapters.cia402.shapes.switching import NOTHING_SWITCHED
from adapters.cia402.triggers import add_triggers
from adapters.cia402.watch import AT_ARM
from adapters.contract import (
    ChunkFit,
    ControllerIdentity,
    ControllerReading,
    DriverCapabilities,
    DriverSetup,
    JogMove,
    LatchedPosition,
    PathChunk,
    ProbedContact,
    ProbeMove,
    SampledPositions,
    SamplingPlan,
    SettingDifference,
    SwitchedOutput,
)
from adapters.toolkit.connection import ConnectedDriver
from adapters.toolkit.refusals import log_refusals
from adapters.toolkit.watched_settings import check_watched_settings
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import CanBusLink, DigitalInput
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import ProbeAbility, StepCosts


class Cia402Driver(
    ConnectedDriver[Cia402Connection],
    SettingsDriver,
    PathDriver,
    RetargetDriver,
    SamplingDriver,
    ShownTriggerDriver,
    LatchDriver,
    ProbeDriver,
    ManualDriver,
    LimitDriver,
    OutputDriver,
    SharedLineDriver,
):
    """Drive one node. Its state arrives by PDO; SDOs take turns per node, and a stop is a separate frame."""

    def __init__(self, setup: DriverSetup, options: Cia402Options) -> None:
        super().__init__(setup, Cia402Lowered)
        self._config = setup.config
        self._options = options
        self._number = node_number(setup.config)
        self._axis, axis = only_axis(setup.config)
        self._bus, self._sync_scheduler = sharing.join_bus(setup, options)
        self._ramp_s = ramp_s(axis)
        self._mapper = PdoMapper(make_pdo_needs(setup.config, options))
        self._streams = needs_stream(setup.config)
        self._following: int | None = CYCLIC_MODE
        """The mode in which the drive follows positions, once it is known."""
        self._boots = 0
        self._is_connected = self._was_unmapped = self._restarted = self._has_equal_ramps = False
        self._broken_off = NOTHING_SWITCHED
        """What the step switched with which the last connection ended."""

    # Connection

    async def connect(self) -> ControllerIdentity:
        link = self._config.link
        assert isinstance(link, CanBusLink)
        sharing.compare_bus(self._bus, link)
        node = (await self._attach_node()).node
        identity = await startup.identify_drive(node, self._options.boot_ms)
        if self._options.eds is not None:
            await startup.compare_product(node, startup.require_product(self._options.eds, self._config, self._options))
        await self._find_following_mode(node)
        self._was_unmapped = await startup.map_and_start(node, self._sync_scheduler, self._options, self._mapper)
        self._boots = node.boots
        await self._end_switching(node)
        if self._was_unmapped:
            self._log.info("the PDOs were mapped differently; they are mapped again")
        self.log_identity(node.name, identity)
        return identity

    async def _attach_node(self) -> Cia402Connection:
        """Attach the drive to its bus; nothing is sent to it."""
        answer_ns = self._options.answer_ms * NS_PER_MS
        node = BusDrive(self._bus, self._number, f"node {self._number}", answer_ns, outputs=self._mapper.needs.outputs)
        await self._bus.attach_node(self._number, node, self._setup.open_link)
        node.log = self._log
        node.inhibit_ns = self._options.inhibit_ms * NS_PER_MS
        node.commanded = CommandedPosition(self._options.rest_window)
        self._log.info("attached to the bus", place=self._config.link.endpoint, node=self._number)
        self._connection = make_connection(self._config, self._options, node, self._sync_scheduler)
        return self._connection

    async def _find_following_mode(self, found: BusDrive) -> None:
        """Determine how the drive follows positions; required only for jerk-limited motion."""
        if self._streams:
            self._following = await startup.find_following_mode(found)
            found.followed = None if self._following is None else FOLLOWED[self._following]
            self._mapper.needs = replace(self._mapper.needs, followed=found.followed)

    async def _end_switching(self, found: BusDrive) -> None:
        """Make the outputs passive that a stream has switched up to the end of the last connection: a drive keeps them
        as they are. By SDO: a controlword could change its state."""
        if self._broken_off.find_active(found.outputs) is not None:
            found.outputs = self._broken_off.outputs_at(found.outputs, self._broken_off.last)
            found.give_position(found.given)
            await found.sdo.write_value(o.OUTPUTS, found.outputs)
            self._log.warning("outputs were still active from a step that was broken off; they are passive now")
        self._broken_off = NOTHING_SWITCHED

    async def configure(self) -> None:
        node = self.connection.node
        await startup.wait_for_rest(node, self._options.busy_wait_s)
        await startup.compare_settings(node, self._config, self._options)
        self._has_equal_ramps = node.has_equal_ramps
        await self.connection.watch.record_settings(node.layout.pdos)
        # Reported by the next poll: a reconnecting adapter must learn that the drive was off meanwhile.
        self._restarted = self._restarted or (self._was_unmapped and self._is_connected)
        self._is_connected = True

    def _step_costs(self, longest_ramp_s: float) -> StepCosts:
        connection = self._connection
        arm_reads = len(AT_ARM) if connection is None else connection.watch.arm_reads + count_accesses(connection.node)
        stands = connection is not None and connection.node.stands_acknowledged
        costs = step_costs(self._options, self._bus.bitrate, len(self._bus.units), longest_ramp_s, arm_reads)
        return costs.model_copy(update={"arm_ns": costs.arm_ns + STANDING_NS * stands})

    @property
    def capabilities(self) -> DriverCapabilities:
        options, costs = self._options, self._step_costs(self._ramp_s)
        return make_capabilities(costs, options.period_ms if self._streams else None, options.watchdog_ms)

    async def poll(self) -> ControllerReading:
        """Return the state that the drive sends unsolicited; nothing is queried."""
        node = self.connection.node
        patience_ns = 3 * max(self._options.heartbeat_ms, self._options.state_ms) * NS_PER_MS
        if self._bus.is_off:
            raise bus_off_fault(node.name)
        await self.connection.reader.require_sign_of_life(self._boots, patience_ns)
        if self._bus.is_off:
            raise bus_off_fault(node.name)
        is_restarted, self._restarted = self._restarted, False
        if node.boots != self._boots:
            is_restarted = True
            await self._reload_drive(node)
        elif not self.connection.mover.is_operating:
            await node.wait_for_second_change()
        return self.connection.reader.make_reading(restarted=is_restarted)

    async def _reload_drive(self, found: BusDrive) -> None:
        """Load again what the drive has lost by a power cycle."""
        self._log.warning("the drive was restarted; its mapping and settings are loaded again", boots=found.boots)
        self.connection.mover.cancel_waits()
        boots = found.boots
        await startup.map_and_start(found, self._sync_scheduler, self._options, self._mapper)
        await startup.compare_settings(found, self._config, self._options)
        await self.connection.watch.record_settings(found.layout.pdos)
        self._boots = boots

    async def check_settings(self, *, everything: bool) -> Sequence[SettingDifference]:
        """Read the objects that determine where a motion goes, or the next two of all objects, by SDO."""
        return await check_watched_settings(self.connection.watch, self._log, everything=everything)

    # Steps

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> Cia402Lowered:
        longest_s = max([self._ramp_s, *(max(profile.durations_s, default=0.0) for profile in profiles.values())])
        times = BusTimes(self._bus.bitrate, self._bus.start_ns, len(self._bus.units), len(self._bus.switching))
        traits = ConnectionTraits(times, self._step_costs(longest_s), self._following, self._has_equal_ramps)
        lowered_step = lower_step(self._config, self._options, traits, profiles, start)
        return add_triggers(lowered_step, self._config, self._options, times, start)

    async def load_chunk(self, chunk: PathChunk, mapping: TickMapping | None) -> ChunkFit:
        del mapping
        with log_refusals(self._log, "the loading of a chunk"):
            return await self.connection.mover.load_chunk(chunk)

    async def release_chunk(self, number: int) -> None:
        with log_refusals(self._log, "the release of a chunk"):
            await self.connection.mover.release_chunk(number)

    async def retarget(self, profiles: Mapping[str, Profile], from_s: float) -> Mapping[str, float]:
        with log_refusals(self._log, "a retarget"):
            return {self._axis: await self.connection.mover.retarget(profiles[self._axis], from_s)}

    async def begin_sampling(self, axes: Sequence[str], period_ns: int, seconds: float) -> SamplingPlan:
        del axes  # it has one
        return self._make_sampling().begin(period_ns, seconds)

    async def take_samples(self) -> SampledPositions:
        return self._make_sampling().take(len(self._bus.units), self._bus.bitrate)

    async def latch_position(self, axis: str, point: DigitalInput, within_ns: int) -> LatchedPosition:
        with log_refusals(self._log, "the touch probe"):
            edge = find_edge(point, self._options.probe_inputs)
            return await TouchProbe(self.connection.node, axis, edge).take(point, within_ns)

    @property
    def probe_ability(self) -> ProbeAbility:
        return find_ability(self._axis, self._options.probe_inputs)

    async def probe_axis(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        with log_refusals(self._log, "the probe"):
            return await ProbeMotion(self.connection, axis, self._options.probe_inputs).run(move)

    async def read_triggers(self, known: Mapping[str, int]) -> Mapping[str, SwitchedOutput]:
        return self.connection.mover.outputs.read_edges(known)

    async def take_triggers(self) -> Mapping[str, SwitchedOutput]:
        return self.connection.mover.outputs.take_edges()

    def _make_sampling(self) -> PdoSampling:
        return PdoSampling(self.connection.node, self._options, self._axis)

    async def stop(self, *, abort: bool) -> None:
        """Stop by halt, with the deceleration of the profile; or by quick stop, with the drive's own."""
        self.connection.mover.record_stop(self.connection.power.write_stop(abort=abort))
        self._log.info("stop written", abort=abort)

    async def stop_before_connect(self) -> bool:
        (await self._attach_node()).power.write_stop(abort=False)
        return True

    # Manual operation

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        power = self.connection.power
        if axes:
            with log_refusals(self._log, "switching the power stage"):
                await power.set_enabled(on=on)

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        manual = self.connection.manual
        return await manual.find_reference(axes, found) if axes else {}

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        del axis
        await self.connection.manual.start_jog(move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        if axes:
            self.connection.power.write_stop(abort=False)

    async def load_soft_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        for pair in limits.values():
            await startup.load_soft_limits(self.connection.node, pair)

    async def set_output(self, number: int, *, on: bool) -> None:
        await self.connection.outputs.set_output(number, on=on)

    async def clear_faults(self) -> None:
        with log_refusals(self._log, "clearing the fault"):
            await self.connection.power.clear_fault()
            watch = self.connection.watch
            if watch.has_differences and await watch.restore_settings():
                await startup.map_and_start(self.connection.node, self._sync_scheduler, self._options, self._mapper)

    async def send_raw(self, command: str) -> str:
        """Execute a raw command: `6041:0/16` reads an object of 16 bits, `6081:0/32=1000` writes it (hexadecimal index
        and sub-index)."""
        return await _access_object(self.connection.node, command)

    async def close(self) -> None:
        old_connection, self._connection = self._connection, None
        if old_connection is None:
            return
        self._log.info("detached from the bus")
        self._sync_scheduler.mark_unknown(self._number)
        await old_connection.end_operation(watched=self._options.watchdog_ms is not None)
        if old_connection.mover.outputs.switching.points:
            self._broken_off = old_connection.mover.outputs.switching
        old_connection.mover.cancel_waits()
        old_connection.power.cancel_stops()
        await self._bus.detach_node(self._number, old_connection.node)
        # Tasks that wait for the drive, such as a reference search, get no further message of it.
        old_connection.node.handle_link_loss(LinkClosed(f"{self._setup.controller} was disconnected"))


async def _access_object(node: BusDrive, command: str) -> str:
    obj, value = _parse_access(command)
    if value is None:
        return str(await node.sdo.read_value(obj))
    await node.sdo.write_value(obj, value)
    return "ok"


def _parse_access(command: str) -> tuple[DictionaryObject, int | None]:
    object_text, equals_sign, value = command.partition("=")
    try:
        address, _, bits = object_text.partition("/")
        index, _, sub = address.partition(":")
        obj = DictionaryObject(
            int(index, 16), int(sub or "0", 16), int(bits or "32"), "object", signed=value.strip().startswith("-")
        )
        if obj.bits not in (8, 16, 32):
            raise ValueError
        number = int(value, 0) if equals_sign else None
        if number is not None:
            obj.encode(number)
    except (ValueError, OverflowError):
        raise Refusal(
            "raw-line", f"{command!r} is not an access to an object", "use 6041:0/16 to read, 6081:0/32=1000 to write"
        ) from None
    return obj, number
