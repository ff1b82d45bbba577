"""One drive on the bus: its state as it reports it, and the commands that it was given."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from adapters.cia402.canopen import states
from adapters.cia402.canopen.bus import EMCY, HEARTBEAT, RPDO, SDO_ANSWER, TPDO, Cia402Bus
from adapters.cia402.canopen.commanded import CommandedPosition
from adapters.cia402.canopen.objects import (
    ACCELERATION,
    ACTUAL,
    CONTROLWORD,
    DECELERATION,
    DEMAND,
    INPUTS,
    MODE,
    MODE_DISPLAY,
    OUTPUTS,
    STATUSWORD,
    VELOCITY,
    DictionaryObject,
)
from adapters.cia402.canopen.pdos import PdoLayout
from adapters.cia402.canopen.sdo import SdoClient, bus_off_fault
from adapters.cia402.canopen.states import DriveState, drive_state_of
from adapters.cia402.canopen.waits import StateWaits
from adapters.cia402.canopen.words import emergency_text
from adapters.contract import NULL_LOG
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame
from orchestrator.model.errors import Refusal

_BOOT_UP = 0x00
_TOGETHER = 3  # changes that are no more than this number of position messages apart are a motion


class SyncAnswer(NamedTuple):
    """A drive's answer to a SYNC: its statusword, and its demanded position when the SYNC came."""

    at_ns: int
    status: int
    demand: int


class BusDrive:
    """State and commands of one drive during a connection. Positions in counts."""

    def __init__(self, bus: Cia402Bus, number: int, name: str, answer_ns: int, *, outputs: bool) -> None:
        self.bus = bus
        self.log = NULL_LOG
        self.number = number
        self.name = name
        self.answer_ns = answer_ns
        self.sdo = SdoClient(bus, number, name, answer_ns)
        self.has_outputs = outputs
        self.followed: DictionaryObject | None = None
        """The object of the positions that are streamed to it; None: none are, so RPDO 4 carries its ramps."""
        self.layout = PdoLayout()
        """Its PDOs, once it is known what it can map."""
        self.commanded = CommandedPosition(0)
        """Its commanded position, of a drive that does not report it."""
        self.given = 0
        """The position that it was given last: one that waits for a SYNC is overwritten with it."""
        self.answer = SyncAnswer(0, 0, 0)
        """Answer to the last SYNC, of a drive that follows positions."""
        self.status = self.mode = 0
        self.demand = self.actual = self.velocity = self.inputs = 0
        self.control = self.wanted_mode = self.outputs = 0
        self.mapped = False
        """Whether its PDOs are mapped as the adapter requires."""
        self.loaded = False
        """Whether a controlword waits in it for a SYNC."""
        self.stops = 0
        self.drops = 0
        """How often it has left operation enabled, by its statusword."""
        self.boots = 0
        self.left_bus = 0
        """How often this computer has left the bus."""
        self.held: dict[DictionaryObject, int] = {}
        """Settings that the drive must hold: loaded or accepted at connecting, or loaded since."""
        self.quick_stop_disables = False
        """Whether a quick stop ends in switch on disabled (605Ah = 2), not in quick stop active."""
        self.emergencies: dict[int, str] = {}
        self.heard_ns = self.state_ns = self.moved_ns = self.acknowledged_ns = 0
        self.running_ns = 0
        """When its position last changed shortly after another change: a single change is a new coordinate."""
        self.inhibit_ns = 10 * NS_PER_MS
        """Shortest time between two of its position messages."""
        self.unresolved_ns = 0
        """When its statusword last showed no result: bits 12 and 13 off."""
        self.stands_acknowledged = False
        """Whether its set-point acknowledge has been seen standing without a set-point."""
        self.nmt = _BOOT_UP
        """Its NMT state, from its last heartbeat."""
        self.beat_ns = 0
        self.positions: list[tuple[int, int]] | None = None
        """Arrival and value of its positions while they are sampled; None: they are not kept."""
        self._waits = StateWaits(bus.clock)

    @property
    def clock(self) -> Clock:
        return self.bus.clock

    @property
    def state(self) -> DriveState:
        return drive_state_of(self.status)

    @property
    def is_enabled(self) -> bool:
        return self.state is DriveState.ENABLED

    @property
    def has_equal_ramps(self) -> bool:
        """Whether it has one ramp for both (6083h), and no 6084h."""
        return DECELERATION in self.layout.absent

    @property
    def braking_ramp(self) -> DictionaryObject:
        """Return the object by which it brakes."""
        return ACCELERATION if self.has_equal_ramps else DECELERATION

    @property
    def switches_with_positions(self) -> bool:
        """Whether its outputs travel with the positions of a stream, and not with the controlword at a SYNC."""
        return self.has_outputs and self.followed is not None

    # Reception

    def handle_frame(self, function: int, frame: CanFrame, at_ns: int) -> None:
        data = frame.data
        self.heard_ns = at_ns
        if function == SDO_ANSWER:
            self.sdo.handle_answer(data, at_ns)
        elif (reading := self.layout.readings.get(function)) is not None:
            if len(data) == reading.byte_size:
                self._take_values(reading.decode(data), at_ns)
        elif function == TPDO[3] and self.layout.answer and len(data) == STATUSWORD.byte_size + DEMAND.byte_size:
            # It may have waited for the bus longer than other messages: it does not show the present state.
            self.answer = SyncAnswer(at_ns, STATUSWORD.decode(data), DEMAND.decode(data[2:]))
        elif function == EMCY and len(data) == 8:
            self._handle_emergency(int.from_bytes(data[:2], "little"))
        elif function == HEARTBEAT and len(data) == 1:
            self._handle_heartbeat(data[0], at_ns)
        self.wake_waiting()

    def _take_values(self, values: Mapping[DictionaryObject, int], at_ns: int) -> None:
        status = values.get(STATUSWORD)
        if status is not None:
            self.handle_status(status, at_ns)
        self.mode = values.get(MODE_DISPLAY, self.mode)
        self.inputs = values.get(INPUTS, self.inputs)
        self.velocity = values.get(VELOCITY, self.velocity)
        actual = values.get(ACTUAL)
        if actual is not None:
            self._take_position(actual, values.get(DEMAND), at_ns)

    def _take_position(self, actual: int, demand: int | None, at_ns: int) -> None:
        """Handle its position. demand: None for a drive that does not report it."""
        if demand is None:
            demand = self.commanded.estimate(actual)
        if demand != self.demand:
            if at_ns - self.moved_ns < _TOGETHER * self.inhibit_ns:
                self.running_ns = at_ns
            self.moved_ns = at_ns
        if VELOCITY not in self.layout.reported and at_ns > self.state_ns:
            self.velocity = round((actual - self.actual) * NS_PER_S / (at_ns - self.state_ns))
        self.demand, self.actual, self.state_ns = demand, actual, at_ns
        if self.positions is not None:
            self.positions.append((at_ns, actual))

    def handle_status(self, status: int, at_ns: int) -> None:
        """Handle a statusword from any source."""
        if status & states.ACKNOWLEDGED and not self.status & states.ACKNOWLEDGED:
            self.acknowledged_ns = at_ns
        if not status & (states.ACKNOWLEDGED | states.MODE_ERROR):
            self.unresolved_ns = at_ns
        was_enabled = self.is_enabled
        self.status = status
        self.drops += was_enabled and not self.is_enabled

    def _handle_emergency(self, code: int) -> None:
        if code == 0:
            self.emergencies.clear()
        else:
            if code not in self.emergencies:
                self.log.warning(f"emergency {code:#06x}: {emergency_text(code)}")
            self.emergencies[code] = emergency_text(code)

    def _handle_heartbeat(self, state: int, at_ns: int) -> None:
        if state == _BOOT_UP:
            self._handle_boot_up()
        self.nmt, self.beat_ns = state, at_ns

    def _handle_boot_up(self) -> None:
        """Handle a boot-up: the drive was power-cycled and has lost everything, its PDO mapping first."""
        self.log.info("the drive has sent a boot-up message")
        self.boots += 1
        self.drops += self.is_enabled
        self.mapped = self.loaded = False
        self.control = self.wanted_mode = self.outputs = self.status = 0
        self.emergencies.clear()

    def handle_bus_off(self, *, off: bool) -> None:
        self.log.warning("this computer has left the bus" if off else "this computer is on the bus again")
        if off:
            self.left_bus += 1
            self.sdo.fail_request(bus_off_fault(self.name))
        self.wake_waiting()

    def handle_link_loss(self, error: LinkClosed) -> None:
        self._waits.close(error)
        self.sdo.fail_request(error)
        self.wake_waiting()

    def wake_waiting(self) -> None:
        """Wake all waiting tasks to check their conditions."""
        self._waits.wake()

    async def wait_until(self, condition: Callable[[], bool], until_ns: int) -> bool:
        """Wait until `condition` holds, at most until that instant; return whether it does. Raises `LinkClosed`."""
        return await self._waits.wait_until(condition, until_ns)

    async def query_status(self) -> None:
        """Query its statusword. Raises `ControllerFault` without an answer."""
        self.handle_status(await self.sdo.read_value(STATUSWORD), self.clock.now_ns())
        self.wake_waiting()

    async def wait_briefly(self, condition: Callable[[], bool]) -> bool:
        """Like `wait_until`, for reactions that a drive shows at once."""
        return await self.wait_until(condition, self.clock.now_ns() + self.answer_ns)

    async def wait_for_second_change(self) -> None:
        """After a change of its position, wait until a further one shows that it moves, or can no longer follow."""
        until_ns = self.moved_ns + _TOGETHER * self.inhibit_ns
        if self.moved_ns and self.running_ns < self.moved_ns:
            await self.wait_until(lambda: self.running_ns >= self.moved_ns, until_ns)

    # Commands

    def send_control(self, control: int, mode: int | None = None) -> None:
        """Send a controlword that takes effect at once. Raises `LinkClosed`."""
        self.bus.send_frames(*self.control_frames(control, mode))

    def control_frames(self, control: int, mode: int | None = None) -> list[CanFrame]:
        """Return the frames of `send_control`. They also overwrite a command, and outputs, that wait for a SYNC, so
        that it requests nothing else."""
        self.control = control
        if mode is not None:
            self.wanted_mode = mode
        control_data = CONTROLWORD.encode(control) + MODE.encode(self.wanted_mode) + self._output_bytes()
        frames = [CanFrame(RPDO[1] + self.number, control_data)]
        if self.switches_with_positions:
            # First: a SYNC that comes between the two must not switch anything after the controlword.
            frames = [self.position_frame(self.given), *frames]
        return [self.control_at_sync(control), *frames] if self.loaded else frames

    def control_at_sync(self, control: int, outputs: int | None = None) -> CanFrame:
        """Return a controlword that takes effect with the next SYNC; with outputs, where these travel with it."""
        output_data = b"" if self.switches_with_positions else self._output_bytes(outputs)
        return CanFrame(RPDO[0] + self.number, CONTROLWORD.encode(control) + output_data)

    def give_position(self, counts: int) -> None:
        """Overwrite the position that waits for a SYNC, of a drive whose outputs travel with it: no older one must come
        after the target that it is given now."""
        self.given = counts
        if self.switches_with_positions:
            self.bus.send_frames(self.position_frame(counts))

    def position_frame(self, counts: int, outputs: int | None = None) -> CanFrame:
        """Return a position of a stream, which takes effect with the next SYNC; with outputs, where some are named."""
        assert self.followed is not None
        return CanFrame(RPDO[3] + self.number, self.followed.encode(counts) + self._output_bytes(outputs))

    def _output_bytes(self, outputs: int | None = None) -> bytes:
        if not self.has_outputs:
            return b""
        return OUTPUTS.encode(self.outputs if outputs is None else outputs)

    # Evaluation

    def require_operational(self) -> None:
        """Raise `Refusal` when it has a fault, or is unreachable."""
        if self.bus.is_off:
            fault = bus_off_fault(self.name)
            raise Refusal(fault.code, fault.text, fault.remedy)
        if self.state in (DriveState.FAULT, DriveState.REACTION):
            raise Refusal("fault", f"{self.name} has a fault: {self.fault_text()}", "clear it with `tutti reset`")

    def fault_text(self) -> str:
        """Return the cause of its fault, from its emergency messages."""
        return "; ".join(self.emergencies.values()) or "the drive has not reported the cause"
