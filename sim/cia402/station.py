"""The node on the bus: NMT, boot-up, heartbeat, node guarding, SYNC, EMCY, TIME, permanent memory (CiA 301)."""

import random
from collections import deque
from collections.abc import Callable

from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, Timer
from orchestrator.link.can import ERROR_BUS_OFF, ERROR_PASSIVE, ERROR_RESTARTED, CanFrame
from orchestrator.link.can_bus import MemoryCanBus
from sim.cia402 import aborts
from sim.cia402.aborts import Abort
from sim.cia402.dictionary import Dictionary
from sim.cia402.drive import COMMUNICATION_CODE, Drive
from sim.cia402.options import Options
from sim.cia402.pdo import Pdos
from sim.cia402.sdo import SdoServer
from sim.core.controller import Timing
from sim.core.devicetime import DeviceTime

OFF, BOOTING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = -1, 0, 4, 5, 127
"""NMT states, as heartbeats tell them; -1: no power."""

_START, _STOP, _ENTER_PRE_OPERATIONAL, _RESET_NODE, _RESET_COMMUNICATION = 1, 2, 0x80, 0x81, 0x82
_NOBODY = 0x8000_0000
_PRODUCES = 0x4000_0000
"""In 0x1005: the node is to send SYNC itself, which this drive can not."""
_ID = 0x7FF
_SAVE, _LOAD = 0x6576_6173, 0x6461_6F6C
_NOT_KEPT = (0x1003, 0x1010, 0x1011, 0x1013, 0x6040)
_HISTORY = 8
_PASSIVE_CODE, _RECOVERED_CODE = 0x8120, 0x8140
_COMMUNICATION = 0x10
_COMMUNICATION_OBJECTS = range(0x1000, 0x2000)


class Station:
    """One drive with its CAN controller. node: its number, 1-127."""

    def __init__(
        self, clock: Clock, time: DeviceTime, bus: MemoryCanBus, node: int, options: Options, timing: Timing, seed: int
    ) -> None:
        draw = random.Random(seed)
        self._clock = clock
        self._time = time
        self._options = options
        self._timing = timing
        self._draw = draw
        self.node = node
        self.state = OFF
        self.dictionary = Dictionary(node, frozenset(int(each, 16) for each in options.without))
        self._delivered = {_key(name): value for name, value in options.objects.items()}
        self._unknown = next((name for name in options.objects if _key(name) not in self.dictionary.entries), None)
        if self._unknown is not None:
            raise ValueError(f"objects: {self._unknown} is none of the drive's objects")
        self._kept = dict(self._delivered)
        self.can = bus.attach(self._hear, self._trouble, bitrate=options.bitrate, by_identifier=True)
        self.can.connect(False)
        self.pdos = Pdos(
            self.dictionary, time, self.can.send, lambda code: self.emergency(code, _COMMUNICATION), self._filter
        )
        phase_ns = draw.randrange(options.cycle_us * NS_PER_US)
        self.drive = Drive(self.dictionary, time, options, phase_ns, self.emergency, self.changed)
        self._sdo = SdoServer(self.dictionary, self._answer, self._watch_transfer)
        self._timers: dict[str, Timer] = {}
        self._emergencies: deque[bytes] = deque()
        self._starts = 0
        self._real_time_ns = 0
        self._sdo_free_ns = 0
        self._toggle = 0
        self._looking = self._following = False
        self._microseconds_ahead = 0
        self._connect_objects()
        self.set_power(True)

    # Power and NMT

    def set_power(self, on: bool) -> None:
        if on and self.state == OFF:
            self._boot()
        elif not on and self.state != OFF:
            self._end(OFF)
            self.drive.power_down()
            self.can.connect(False)

    def _end(self, state: int) -> None:
        """Nothing that was under way goes on."""
        self.state = state
        self._starts += 1
        self.pdos.stop()
        self._sdo.reset()
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        self._emergencies.clear()

    def _boot(self) -> None:
        self._end(BOOTING)
        self._later("boot", self._options.boot_ms * NS_PER_MS, self._booted)

    def _booted(self) -> None:
        self.dictionary.reset(self._kept)
        self.dictionary.put(0x1018, 4, self._options.serial)
        self.drive.power_up()
        if not self.can.connected:
            self.can.connect(True)
        self._ready()

    def _ready(self) -> None:
        """The boot-up message ends every start of communication."""
        self.state = PRE_OPERATIONAL
        self._toggle = 0
        self._filter()
        self.can.send(CanFrame(0x700 + self.node, b"\0"))
        self._restart_heartbeat(self.dictionary.get(0x1017))

    def _command(self, command: int) -> None:
        if command == _START and self.state != OPERATIONAL:
            self.state = OPERATIONAL
            self.pdos.start()
        elif command in (_STOP, _ENTER_PRE_OPERATIONAL):
            wanted = STOPPED if command == _STOP else PRE_OPERATIONAL
            if self.state != wanted:
                self.state = wanted
                self.pdos.stop()
                self._sdo.reset()
                if wanted == STOPPED:
                    self.drive.connection_lost()
        elif command == _RESET_NODE:
            self.drive.power_down()
            self._boot()
        elif command == _RESET_COMMUNICATION:
            self.drive.connection_lost()
            self._end(BOOTING)
            kept = {key: value for key, value in self._kept.items() if key[0] in _COMMUNICATION_OBJECTS}
            application = {k: v for k, v in self.dictionary.writable().items() if k[0] not in _COMMUNICATION_OBJECTS}
            self.dictionary.reset(kept | application)
            self._later("boot", NS_PER_MS, self._ready)

    def _later(self, name: str, after_ns: int, callback: Callable[[], None]) -> None:
        """Call back unless this node is started anew before, or the timer of this name is set again."""
        old = self._timers.pop(name, None)
        if old is not None:
            old.cancel()
        self._timers[name] = self._time.call_after(after_ns, callback)

    def _drop(self, name: str) -> None:
        timer = self._timers.pop(name, None)
        if timer is not None:
            timer.cancel()

    # From the bus

    def _hear(self, frame: CanFrame) -> None:
        if self.state in (OFF, BOOTING) or frame.extended:
            return
        if frame.id == 0x600 + self.node and not frame.rtr:
            if self.state in (PRE_OPERATIONAL, OPERATIONAL):
                self._soon(lambda: self._sdo.request(frame.data))
        elif frame.id == 0x700 + self.node and frame.rtr:
            self._guarded()
        elif frame.id > 0x700:
            self._heard_heartbeat(frame.id - 0x700)
        else:
            self._at_once(lambda: self._act(frame))

    def _soon(self, action: Callable[[], None]) -> None:
        """SDOs are answered one after another, beside everything else."""
        timing, now_ns = self._timing, self._clock.now_ns()
        took_ns = timing.decode_ns + self._draw.randint(0, timing.spread_ns)
        self._sdo_free_ns = max(self._sdo_free_ns, now_ns) + took_ns
        self._run(self._sdo_free_ns, action)

    def _at_once(self, action: Callable[[], None]) -> None:
        """What the firmware takes from an interrupt, in its order."""
        options = self._options
        took_us = options.real_time_us + self._draw.random() * options.real_time_spread_us
        self._real_time_ns = max(self._real_time_ns, self._clock.now_ns() + round(took_us * NS_PER_US))
        self._run(self._real_time_ns, action)

    def _run(self, at_ns: int, action: Callable[[], None]) -> None:
        start = self._starts

        def due() -> None:
            if self._starts == start:
                action()

        self._clock.call_at_ns(at_ns, due)

    def _act(self, frame: CanFrame) -> None:
        if frame.id == 0:
            if len(frame.data) == 2 and frame.data[1] in (0, self.node):
                self._command(frame.data[0])
        elif frame.id == self._sync_id():
            if self.state == OPERATIONAL:
                self.pdos.sync_incoming()
                self.drive.sync()
                self.pdos.sync_outgoing()
        elif self.state == OPERATIONAL:
            self.pdos.receive(frame)

    def _sync_id(self) -> int:
        return self.dictionary.get(0x1005) & _ID

    def _filter(self) -> None:
        """Set the acceptance filter of the CAN controller: what is for others does not reach the firmware."""
        own = {0, self._sync_id(), 0x600 + self.node, 0x700 + self.node}
        watched = {0x700 + (self.dictionary.get(0x1016, sub) >> 16 & 0x7F) for sub in (1, 2)}
        self.can.accepts = frozenset(own | watched | self.pdos.identifiers())

    def _take_filtered(self, index: int, sub: int, value: int) -> None:
        self.dictionary.put(index, sub, value)
        self._filter()

    # To the bus

    def changed(self) -> None:
        """Something that a PDO may carry has changed: looked at when the present instant's work is done."""
        if not self._looking and self.state == OPERATIONAL:
            self._looking = True
            self._clock.call_at_ns(self._clock.now_ns(), self._look)

    def _look(self) -> None:
        self._looking = False
        self.pdos.changed()
        if self.drive.servo.mover.moving and not self._following and self.pdos.follows_motion:
            self._following = True
            self._time.call_after(self._options.event_ms * NS_PER_MS, self._look_again)

    def _look_again(self) -> None:
        self._following = False
        self.changed()

    def _answer(self, data: bytes) -> None:
        self.can.send(CanFrame(0x580 + self.node, data))

    def _watch_transfer(self, on: bool) -> None:
        if on and self._options.sdo_timeout_ms:
            self._later("sdo", self._options.sdo_timeout_ms * NS_PER_MS, self._sdo.give_up)
        else:
            self._drop("sdo")

    def emergency(self, code: int, register: int) -> None:
        """EMCY, and the error in the history. Code 0: no error is left."""
        dictionary = self.dictionary
        dictionary.put(0x1001, 0, register)
        if code:
            errors = [dictionary.get(0x1003, sub) for sub in range(1, _HISTORY)]
            for sub, error in enumerate([code, *errors], 1):
                dictionary.put(0x1003, sub, error)
            dictionary.put(0x1003, 0, min(_HISTORY, dictionary.get(0x1003, 0) + 1))
        if self.state in (PRE_OPERATIONAL, OPERATIONAL) and not dictionary.get(0x1014) & _NOBODY:
            self._emergencies.append(code.to_bytes(2, "little") + bytes([register, 0, 0, 0, 0, 0]))
            if "emergency" not in self._timers:
                self._tell_emergency()

    def _tell_emergency(self) -> None:
        """One at a time, each after the inhibit time of the one before (0x1015, in 100 µs)."""
        self._drop("emergency")
        if not self._emergencies:
            return
        self.can.send(CanFrame(self.dictionary.get(0x1014) & _ID, self._emergencies.popleft()))
        inhibit_ns = self.dictionary.get(0x1015) * 100 * NS_PER_US
        if inhibit_ns:
            self._later("emergency", inhibit_ns, self._tell_emergency)
        elif self._emergencies:
            self._tell_emergency()

    # Being watched, and watching

    def _restart_heartbeat(self, every_ms: int) -> None:
        self._drop("heartbeat")
        if every_ms:

            def beat() -> None:
                self.can.send(CanFrame(0x700 + self.node, bytes([self.state])))
                self._later("heartbeat", every_ms * NS_PER_MS, beat)

            self._later("heartbeat", every_ms * NS_PER_MS, beat)

    def _guarded(self) -> None:
        """Node guarding: answered with the state and a bit that alternates."""
        self.can.send(CanFrame(0x700 + self.node, bytes([self.state | self._toggle << 7])))
        self._toggle ^= 1
        life_ms = self.dictionary.get(0x100C) * self.dictionary.get(0x100D)
        if life_ms:
            self._later("life", life_ms * NS_PER_MS, self._forsaken)

    def _heard_heartbeat(self, node: int) -> None:
        for sub in (1, 2):
            word = self.dictionary.get(0x1016, sub)
            if word >> 16 & 0x7F == node and word & 0xFFFF:
                self._later(f"consumer{sub}", (word & 0xFFFF) * NS_PER_MS, self._forsaken)

    def _forsaken(self) -> None:
        """Whoever watched this node, or was watched by it, is gone."""
        self.emergency(COMMUNICATION_CODE, _COMMUNICATION | 1)
        self._communication_error()

    def _communication_error(self) -> None:
        self.drive.connection_lost()
        behaviour = self.dictionary.get(0x1029, 1)
        if behaviour == 0 and self.state == OPERATIONAL:
            self._command(_ENTER_PRE_OPERATIONAL)
        elif behaviour == 2:
            self._command(_STOP)

    def _trouble(self, what: int) -> None:
        if what == ERROR_BUS_OFF:
            self._clock.call_at_ns(self._clock.now_ns() + self._options.bus_off_ms * NS_PER_MS, self.can.restart)
            self._communication_error()
        elif what == ERROR_RESTARTED:
            self.emergency(_RECOVERED_CODE, _COMMUNICATION)
        elif what == ERROR_PASSIVE and self.can.state == "passive":
            self.emergency(_PASSIVE_CODE, _COMMUNICATION)

    # Objects of the node itself

    def _connect_objects(self) -> None:
        reads, writes = self.dictionary.reads, self.dictionary.writes
        reads[0x1010, 1] = reads[0x1011, 1] = lambda: 1
        writes[0x1010, 1] = self._save
        writes[0x1011, 1] = self._load
        writes[0x1017, 0] = self._restart_heartbeat
        writes[0x1003, 0] = self._clear_history
        for sub in (1, 2):
            writes[0x1016, sub] = lambda value, sub=sub: self._watch_other(sub, value)
        writes[0x1005, 0] = self._new_sync
        reads[0x1013, 0] = self._microseconds
        writes[0x1013, 0] = self._set_microseconds

    def _watch_other(self, sub: int, value: int) -> None:
        self._drop(f"consumer{sub}")
        self._take_filtered(0x1016, sub, value)

    def _new_sync(self, value: int) -> None:
        if value & _PRODUCES:
            raise Abort(aborts.RANGE)
        self._take_filtered(0x1005, 0, value)

    def _save(self, signature: int) -> None:
        if signature != _SAVE:
            raise Abort(aborts.NOT_STORED)
        kept = self.dictionary.writable()
        self._kept = {key: value for key, value in kept.items() if key[0] not in _NOT_KEPT}

    def _load(self, signature: int) -> None:
        if signature != _LOAD:
            raise Abort(aborts.NOT_STORED)
        self._kept = dict(self._delivered)

    def _clear_history(self, value: int) -> None:
        if value:
            raise Abort(aborts.RANGE)
        for sub in range(1, _HISTORY + 1):
            self.dictionary.put(0x1003, sub, 0)

    def _microseconds(self) -> int:
        return (self._time.now_ns() // NS_PER_US + self._microseconds_ahead) % (1 << 32)

    def _set_microseconds(self, value: int) -> None:
        self._microseconds_ahead = value - self._time.now_ns() // NS_PER_US


def _key(name: str) -> tuple[int, int]:
    """`6091:1` as index and sub-index."""
    index, _, sub = name.partition(":")
    return int(index, 16), int(sub or "0", 16)
