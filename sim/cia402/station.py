"""The node on the bus: NMT, boot-up, heartbeat, node guarding, SYNC, EMCY, TIME, permanent memory (CiA 301)."""

import random
from collections.abc import Callable

from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.link.can import ERROR_BUS_OFF, ERROR_PASSIVE, ERROR_RESTARTED, CanFrame
from orchestrator.link.can_bus import MemoryCanBus
from sim.cia402 import aborts
from sim.cia402.aborts import SdoAbort
from sim.cia402.dictionary import DriveDictionary
from sim.cia402.drive import COMMUNICATION_CODE, DriveEvents, ServoDrive
from sim.cia402.emergency import EmergencyProducer
from sim.cia402.options import DriveOptions
from sim.cia402.pdo import PdoSet
from sim.cia402.permanent import PermanentObjects
from sim.cia402.sdo import SdoServer
from sim.cia402.supervision import NodeSupervision
from sim.cia402.timers import MicrosecondCounter, NodeTimers
from sim.core.controller import DeviceSpec
from sim.core.devicetime import DeviceTime

OFF, BOOTING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = -1, 0, 4, 5, 127
"""NMT states, as heartbeats report them; -1: no power."""

_START, _STOP, _ENTER_PRE_OPERATIONAL, _RESET_NODE, _RESET_COMMUNICATION = 1, 2, 0x80, 0x81, 0x82
_PRODUCES = 0x4000_0000
"""In 0x1005: the node is to produce SYNC itself, which this drive does not support."""
_ID = 0x7FF
_PASSIVE_CODE, _RECOVERED_CODE = 0x8120, 0x8140
_COMMUNICATION = 0x10
_COMMUNICATION_OBJECTS = range(0x1000, 0x2000)


class DriveNode:
    """One drive with its CAN controller. Its node number, 1-127, is the address of `device`; 1 without one."""

    def __init__(self, time: DeviceTime, bus: MemoryCanBus, options: DriveOptions, device: DeviceSpec) -> None:
        draw = random.Random(device.seed)
        node = 1 if device.address is None else device.address
        self._clock = time.clock
        self._time = time
        self._options = options
        self._timing = device.timing
        self._draw = draw
        self.node = node
        self.state = OFF
        self.dictionary = DriveDictionary(node, options.hidden_indices, options.eds)
        self._permanent = PermanentObjects(self.dictionary, options)
        self.can = bus.attach_node(
            self._receive_frame, self._handle_bus_error, bitrate=options.bitrate, by_identifier=True
        )
        self.can.set_connected(connected=False)
        self._timers = NodeTimers(time)
        self.emergencies = EmergencyProducer(
            self.dictionary,
            self._timers,
            self.can.queue_frames,
            lambda: self.state in (PRE_OPERATIONAL, OPERATIONAL),
        )
        self._supervision = NodeSupervision(self, self._timers)
        self.pdos = PdoSet(
            self.dictionary,
            time,
            self.can.queue_frames,
            lambda code: self.emergencies.send_emergency(code, _COMMUNICATION),
            self._set_filter,
        )
        phase_ns = draw.randrange(options.cycle_us * NS_PER_US)
        events = DriveEvents(self.emergencies.send_emergency, self.schedule_pdo_check)
        self.drive = ServoDrive(self.dictionary, time, options, phase_ns, events)
        self._sdo = SdoServer(self.dictionary, self._send_sdo_reply, lambda on: self._watch_transfer(on=on))
        self._starts = 0
        self._real_time_ns = 0
        self._sdo_free_ns = 0
        self._looking = self._following = False
        self._counter = MicrosecondCounter(time)
        self._connect_objects()
        self.set_power(on=True)

    # Power and NMT

    def set_power(self, *, on: bool) -> None:
        if on and self.state == OFF:
            self._start_boot()
        elif not on and self.state != OFF:
            self._end_activity(OFF)
            self.drive.power_down()
            self.can.set_connected(connected=False)

    def _end_activity(self, state: int) -> None:
        """Cancel all activity."""
        self.state = state
        self._starts += 1
        self.pdos.stop_sending()
        self._sdo.reset_transfer()
        self._timers.cancel_all()
        self.emergencies.clear_queue()

    def _start_boot(self) -> None:
        self._end_activity(BOOTING)
        self._timers.call_later("boot", self._options.boot_ms * NS_PER_MS, self._finish_boot)

    def _finish_boot(self) -> None:
        self.dictionary.reset_values(self._permanent.kept)
        self.dictionary.put_value(0x1018, 4, self._options.serial)
        self.drive.power_up()
        if not self.can.connected:
            self.can.set_connected(connected=True)
        self._send_boot_up()

    def _send_boot_up(self) -> None:
        """Send the boot-up message, which ends every start of communication."""
        self.state = PRE_OPERATIONAL
        self._supervision.reset_toggle()
        self._set_filter()
        self.can.queue_frames(CanFrame(0x700 + self.node, b"\0"))
        self._supervision.restart_heartbeat(self.dictionary.get_value(0x1017))

    def _handle_nmt(self, command: int) -> None:
        if command == _START and self.state != OPERATIONAL:
            self.state = OPERATIONAL
            self.pdos.start_sending()
        elif command in (_STOP, _ENTER_PRE_OPERATIONAL):
            new_state = STOPPED if command == _STOP else PRE_OPERATIONAL
            if self.state != new_state:
                self.state = new_state
                self.pdos.stop_sending()
                self._sdo.reset_transfer()
                if new_state == STOPPED:
                    self.drive.connection_lost()
        elif command == _RESET_NODE:
            self.drive.power_down()
            self._start_boot()
        elif command == _RESET_COMMUNICATION:
            self.drive.connection_lost()
            self._end_activity(BOOTING)
            kept_values = {
                key: value for key, value in self._permanent.kept.items() if key[0] in _COMMUNICATION_OBJECTS
            }
            application = {
                k: v for k, v in self.dictionary.writable_values().items() if k[0] not in _COMMUNICATION_OBJECTS
            }
            self.dictionary.reset_values(kept_values | application)
            self._timers.call_later("boot", NS_PER_MS, self._send_boot_up)

    # From the bus

    def _receive_frame(self, frame: CanFrame) -> None:
        if self.state in (OFF, BOOTING) or frame.extended:
            return
        if frame.id == 0x600 + self.node and not frame.rtr:
            if self.state in (PRE_OPERATIONAL, OPERATIONAL):
                self._queue_request(lambda: self._sdo.handle_request(frame.data))
        elif frame.id == 0x700 + self.node and frame.rtr:
            self._supervision.answer_guarding()
        elif frame.id > 0x700:
            self._supervision.handle_heartbeat(frame.id - 0x700)
        else:
            self._queue_interrupt(lambda: self._process_frame(frame))

    def _queue_request(self, action: Callable[[], None]) -> None:
        """Queue an action: SDOs are answered one after another, concurrently with everything else."""
        timing, now_ns = self._timing, self._clock.now_ns()
        took_ns = timing.decode_ns + self._draw.randint(0, timing.spread_ns)
        self._sdo_free_ns = max(self._sdo_free_ns, now_ns) + took_ns
        self._run_at(self._sdo_free_ns, action)

    def _queue_interrupt(self, action: Callable[[], None]) -> None:
        """Queue an action that the firmware runs from an interrupt, in order."""
        options = self._options
        took_us = options.real_time_us + self._draw.random() * options.real_time_spread_us
        self._real_time_ns = max(self._real_time_ns, self._clock.now_ns() + round(took_us * NS_PER_US))
        self._run_at(self._real_time_ns, action)

    def _run_at(self, at_ns: int, action: Callable[[], None]) -> None:
        start = self._starts

        def run_action() -> None:
            if self._starts == start:
                action()

        self._clock.call_at_ns(at_ns, run_action)

    def _process_frame(self, frame: CanFrame) -> None:
        if frame.id == 0:
            if len(frame.data) == 2 and frame.data[1] in (0, self.node):
                self._handle_nmt(frame.data[0])
        elif frame.id == self._sync_id():
            if self.state == OPERATIONAL:
                self.pdos.sync_incoming()
                self.drive.handle_sync()
                self.pdos.sync_outgoing()
        elif self.state == OPERATIONAL:
            self.pdos.handle_frame(frame)

    def _sync_id(self) -> int:
        return self.dictionary.get_value(0x1005) & _ID

    def _set_filter(self) -> None:
        """Set the acceptance filter of the CAN controller: frames for other nodes do not reach the firmware."""
        own = {0, self._sync_id(), 0x600 + self.node, 0x700 + self.node}
        watched_values = {0x700 + (self.dictionary.get_value(0x1016, sub) >> 16 & 0x7F) for sub in (1, 2)}
        self.can.accepts = frozenset(own | watched_values | self.pdos.receive_identifiers())

    def _store_filtered(self, index: int, sub: int, value: int) -> None:
        self.dictionary.put_value(index, sub, value)
        self._set_filter()

    # To the bus

    def schedule_pdo_check(self) -> None:
        """Schedule a check of the PDOs, after the work of the present instant."""
        if not self._looking and self.state == OPERATIONAL:
            self._looking = True
            self._clock.call_at_ns(self._clock.now_ns(), self._check_pdos)

    def _check_pdos(self) -> None:
        self._looking = False
        self.pdos.check_changes()
        if self.drive.servo.mover.is_moving and not self._following and self.pdos.follows_motion:
            self._following = True
            self._time.call_after(self._options.event_ms * NS_PER_MS, self._recheck_pdos)

    def _recheck_pdos(self) -> None:
        self._following = False
        self.schedule_pdo_check()

    def _send_sdo_reply(self, data: bytes) -> None:
        self.can.queue_frames(CanFrame(0x580 + self.node, data))

    def _watch_transfer(self, *, on: bool) -> None:
        if on and self._options.sdo_timeout_ms:
            self._timers.call_later("sdo", self._options.sdo_timeout_ms * NS_PER_MS, self._sdo.abort_timed_out)
        else:
            self._timers.cancel_timer("sdo")

    # Node guarding and heartbeats

    def handle_node_loss(self) -> None:
        """Handle the loss of the node that guards this one, or of a node that this one watches."""
        self.emergencies.send_emergency(COMMUNICATION_CODE, _COMMUNICATION | 1)
        self._report_communication_error()

    def _report_communication_error(self) -> None:
        self.drive.connection_lost()
        behaviour = self.dictionary.get_value(0x1029, 1)
        if behaviour == 0 and self.state == OPERATIONAL:
            self._handle_nmt(_ENTER_PRE_OPERATIONAL)
        elif behaviour == 2:
            self._handle_nmt(_STOP)

    def _handle_bus_error(self, what: int) -> None:
        if what == ERROR_BUS_OFF:
            self._clock.call_at_ns(self._clock.now_ns() + self._options.bus_off_ms * NS_PER_MS, self.can.leave_bus_off)
            self._report_communication_error()
        elif what == ERROR_RESTARTED:
            self.emergencies.send_emergency(_RECOVERED_CODE, _COMMUNICATION)
        elif what == ERROR_PASSIVE and self.can.node_state == "passive":
            self.emergencies.send_emergency(_PASSIVE_CODE, _COMMUNICATION)

    # Objects of the node itself

    def _connect_objects(self) -> None:
        reads, writes = self.dictionary.reads, self.dictionary.writes
        reads[0x1010, 1] = reads[0x1011, 1] = lambda: 1
        writes[0x1010, 1] = self._permanent.save_objects
        writes[0x1011, 1] = self._permanent.load_objects
        writes[0x1017, 0] = self._supervision.restart_heartbeat
        writes[0x1003, 0] = self.emergencies.clear_history
        for sub in (1, 2):
            writes[0x1016, sub] = lambda value, sub=sub: self._watch_other(sub, value)
        writes[0x1005, 0] = self._new_sync
        reads[0x1013, 0] = self._counter.read_counter
        writes[0x1013, 0] = self._counter.set_counter

    def _watch_other(self, sub: int, value: int) -> None:
        self._timers.cancel_timer(f"consumer{sub}")
        self._store_filtered(0x1016, sub, value)

    def _new_sync(self, value: int) -> None:
        if value & _PRODUCES:
            raise SdoAbort(aborts.RANGE)
        self._store_filtered(0x1005, 0, value)
