"""PDOs: parameters and mapping, transmission types, inhibit time and event timer (CiA 301, 7.2.2 and 7.5.2)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from orchestrator.clock.base import NS_PER_MS, NS_PER_US, ClockTimer
from orchestrator.link.can import CanFrame
from sim.cia402 import aborts
from sim.cia402.aborts import SdoAbort
from sim.cia402.dictionary import DriveDictionary
from sim.core.devicetime import DeviceTime

COUNT = 4
MOST_OBJECTS = 8
_OFF = 0x8000_0000
_NO_REMOTE = 0x4000_0000
_EXTENDED = 0x2000_0000
_ID = 0x7FF
_SYNCHRONOUS_UP_TO = 240
_REMOTE_SYNCHRONOUS = 252
_EVENT_FROM = 254
_TURNING = (0x6062, 0x6063, 0x6064, 0x606B, 0x606C, 0x60F4, 0x60FC)
CONTROLWORD = (0x6040, 0)
LENGTH_ERROR = 0x8210

# Identifiers that no PDO may have (CiA 301, table 40): those of NMT, SDOs, LSS and heartbeats.
_RESTRICTED = (
    range(0x000, 0x080),
    range(0x101, 0x181),
    range(0x581, 0x600),
    range(0x601, 0x680),
    range(0x6E0, 0x700),
    range(0x701, 0x800),
)


@dataclass(slots=True)
class _PdoParameters:
    """One PDO as its parameters define it.

    objects: key and bytes of each."""

    parameter: int
    mapping: int
    id: int = 0
    on: bool = False
    remote: bool = False
    type: int = 255
    objects: tuple[tuple[tuple[int, int], int], ...] = ()


@dataclass(slots=True)
class _TransmitPdo(_PdoParameters):
    """A transmit PDO.

    values: sources of its objects' values, with bytes and sign.
    last: the data sent last.
    free_ns: end of the inhibit time after it."""

    values: tuple[tuple[Callable[[], int], int, bool], ...] = ()
    last: bytes = b""
    syncs: int = 0
    free_ns: int = 0
    waiting: ClockTimer | None = None
    event: ClockTimer | None = None


@dataclass(slots=True)
class _ReceivePdo(_PdoParameters):
    """A receive PDO.

    held: data received since the last SYNC."""

    held: bytes | None = None


class PdoSet:
    """All PDOs of one drive.

    send: puts a frame on the bus.
    emergency: sends an EMCY with this code.
    other_identifiers: called when the identifiers of the received frames have changed.
    """

    def __init__(
        self,
        dictionary: DriveDictionary,
        time: DeviceTime,
        send: Callable[[CanFrame], None],
        emergency: Callable[[int], None],
        other_identifiers: Callable[[], None],
    ) -> None:
        self._dictionary = dictionary
        self._time = time
        self._send = send
        self._emergency = emergency
        self._other_identifiers = other_identifiers
        self._running = False
        self.follows_motion = False
        """Whether an event-driven PDO carries values that change while the motor turns."""
        self._incoming = [_ReceivePdo(0x1400 + n, 0x1600 + n) for n in range(COUNT)]
        self._outgoing = [_TransmitPdo(0x1800 + n, 0x1A00 + n) for n in range(COUNT)]
        for pdo in (*self._incoming, *self._outgoing):
            self._guard_parameters(pdo)

    # Parameters

    def _guard_parameters(self, pdo: _PdoParameters) -> None:
        """Install the checks for writes of its parameters."""
        writes, receive = self._dictionary.writes, isinstance(pdo, _ReceivePdo)
        writes[pdo.parameter, 1] = lambda value: self._check_id(pdo, value)
        writes[pdo.parameter, 2] = lambda value: self._check_type(pdo, value, receive=receive)
        if not receive:
            writes[pdo.parameter, 3] = lambda _: self._require_off(pdo)
            writes[pdo.parameter, 5] = lambda value: self._new_event_timer(pdo, value)
        writes[pdo.mapping, 0] = lambda value: self._check_count(pdo, value, receive=receive)
        for sub in range(1, MOST_OBJECTS + 1):
            writes[pdo.mapping, sub] = lambda value: self._check_object(pdo, value, receive=receive)

    def _require_off(self, pdo: _PdoParameters) -> None:
        if not self._dictionary.is_writable(pdo.parameter, 1):
            return  # it cannot be switched off
        if not self._dictionary.get_value(pdo.parameter, 1) & _OFF:
            raise SdoAbort(aborts.UNSUPPORTED)

    def _check_id(self, pdo: _PdoParameters, value: int) -> None:
        old_value, identifier = self._dictionary.get_value(pdo.parameter, 1), value & _ID
        if value & _EXTENDED or any(identifier in identifiers for identifiers in _RESTRICTED):
            raise SdoAbort(aborts.RANGE)
        if not old_value & _OFF and not value & _OFF and old_value & _ID != identifier:
            raise SdoAbort(aborts.RANGE)
        self._after_write(pdo, (pdo.parameter, 1), value)

    def _check_type(self, pdo: _PdoParameters, value: int, *, receive: bool) -> None:
        if _SYNCHRONOUS_UP_TO < value < _EVENT_FROM and (receive or value < _REMOTE_SYNCHRONOUS):
            raise SdoAbort(aborts.RANGE)
        self._after_write(pdo, (pdo.parameter, 2), value)

    def _new_event_timer(self, pdo: _PdoParameters, value: int) -> None:
        self._after_write(pdo, (pdo.parameter, 5), value)

    def _check_count(self, pdo: _PdoParameters, value: int, *, receive: bool) -> None:
        self._require_off(pdo)
        if value > MOST_OBJECTS:
            raise SdoAbort(aborts.TOO_HIGH)
        bits = 0
        for sub in range(1, value + 1):
            word = self._dictionary.get_value(pdo.mapping, sub)
            self._check_mapped(word, receive=receive)
            bits += word & 0xFF
        if bits > 64:
            raise SdoAbort(aborts.PDO_LENGTH)
        self._after_write(pdo, (pdo.mapping, 0), value)

    def _check_object(self, pdo: _PdoParameters, value: int, *, receive: bool) -> None:
        self._require_off(pdo)
        if self._dictionary.get_value(pdo.mapping, 0):
            raise SdoAbort(aborts.UNSUPPORTED)
        if value:
            self._check_mapped(value, receive=receive)

    def _check_mapped(self, word: int, *, receive: bool) -> None:
        entry = self._dictionary.find_entry(word >> 16, word >> 8 & 0xFF)
        if not entry.mappable or entry.size * 8 != word & 0xFF or (receive and not entry.writable):
            raise SdoAbort(aborts.NOT_MAPPABLE)

    def _after_write(self, pdo: _PdoParameters, key: tuple[int, int], value: int) -> None:
        self._dictionary.put_value(*key, value)
        self._read_parameters(pdo)

    def _read_parameters(self, pdo: _PdoParameters) -> None:
        """Apply the parameters."""
        get = self._dictionary.get_value
        word = get(pdo.parameter, 1)
        mappings = [get(pdo.mapping, sub) for sub in range(1, get(pdo.mapping, 0) + 1)]
        pdo.id, pdo.on, pdo.remote = word & _ID, not word & _OFF, not word & _NO_REMOTE
        pdo.type = get(pdo.parameter, 2)
        pdo.objects = tuple(((entry >> 16, entry >> 8 & 0xFF), (entry & 0xFF) // 8) for entry in mappings)
        if isinstance(pdo, _ReceivePdo):
            pdo.held = None
        elif isinstance(pdo, _TransmitPdo):
            reads, entries = self._dictionary.reads, self._dictionary.entries
            pdo.values = tuple(
                (reads.get(key) or partial(get, *key), size, entries[key].signed) for key, size in pdo.objects
            )
            self._arm_event_timer(pdo)
        self.follows_motion = any(
            pdo.on and pdo.type >= _EVENT_FROM and any(key[0] in _TURNING for key, _ in pdo.objects)
            for pdo in self._outgoing
        )
        self._other_identifiers()

    # State

    def start_sending(self) -> None:
        """Enter NMT state operational: event-driven PDOs are sent once."""
        self._running = True
        for pdo in (*self._incoming, *self._outgoing):
            self._read_parameters(pdo)
        for pdo in self._outgoing:
            pdo.last, pdo.syncs, pdo.free_ns = b"", 0, 0
        self.check_changes()

    def stop_sending(self) -> None:
        self._running = False
        for pdo in self._outgoing:
            for timer in (pdo.waiting, pdo.event):
                if timer is not None:
                    timer.cancel()
            pdo.waiting = pdo.event = None

    # From the bus

    def receive_identifiers(self) -> set[int]:
        """Return the identifiers of the frames that may be for one of the PDOs."""
        return {pdo.id for pdo in (*self._incoming, *self._outgoing) if pdo.on}

    def handle_frame(self, frame: CanFrame) -> None:
        """Process a frame that may be for one of the PDOs."""
        if not self._running:
            return
        if frame.rtr:
            for pdo in self._outgoing:
                if pdo.on and pdo.remote and pdo.id == frame.id:
                    self._transmit_pdo(pdo)
            return
        for pdo in self._incoming:
            if pdo.on and pdo.id == frame.id:
                if len(frame.data) < sum(size for _, size in pdo.objects):
                    self._emergency(LENGTH_ERROR)
                elif pdo.type <= _SYNCHRONOUS_UP_TO:
                    pdo.held = frame.data
                else:
                    self._apply_received([(pdo, frame.data)])

    def sync_incoming(self) -> None:
        """SYNC: move the held data into the objects."""
        held_pdos = [(pdo, pdo.held) for pdo in self._incoming if pdo.held is not None]
        for pdo, _ in held_pdos:
            pdo.held = None
        self._apply_received(held_pdos)

    def _apply_received(self, received: "list[tuple[_ReceivePdo, bytes]]") -> None:
        """Apply received PDOs. The control loop processes all of them at once: the controlword acts on the other
        values that arrive with it."""
        words: list[int] = []
        for pdo, data in received:
            at = 0
            for key, size in pdo.objects:
                value = self._dictionary.entries[key].decode_value(data[at : at + size])
                at += size
                if key == CONTROLWORD:
                    words.append(value)
                else:
                    self._apply_object(key, value)
        for word in words:
            self._apply_object(CONTROLWORD, word)

    def _apply_object(self, key: tuple[int, int], value: int) -> None:
        try:
            self._dictionary.accept_value(*key, value)
        except SdoAbort:
            # A PDO has no reply to carry a refusal: the object keeps its value.
            return

    # To the bus

    def sync_outgoing(self) -> None:
        """SYNC: send the synchronous PDOs."""
        if not self._running:
            return
        for pdo in self._outgoing:
            if not pdo.on:
                continue
            if pdo.type == 0 and self._encode_values(pdo) != pdo.last:
                self._transmit_pdo(pdo)
            elif 1 <= pdo.type <= _SYNCHRONOUS_UP_TO:
                pdo.syncs += 1
                if pdo.syncs >= pdo.type:
                    pdo.syncs = 0
                    self._transmit_pdo(pdo)

    def check_changes(self) -> None:
        """Check the event-driven PDOs after a possible change of an object, and send those whose values have
        changed."""
        if not self._running:
            return
        now_ns = self._time.now_ns()
        for pdo in self._outgoing:
            if pdo.on and pdo.type >= _EVENT_FROM and pdo.waiting is None and self._encode_values(pdo) != pdo.last:
                if now_ns >= pdo.free_ns:
                    self._transmit_pdo(pdo)
                else:
                    pdo.waiting = self._time.call_at(pdo.free_ns, lambda p=pdo: self._handle_inhibit_end(p))

    def _handle_inhibit_end(self, pdo: _TransmitPdo) -> None:
        pdo.waiting = None
        if pdo.on and self._encode_values(pdo) != pdo.last:
            self._transmit_pdo(pdo)

    def _encode_values(self, pdo: _TransmitPdo) -> bytes:
        return b"".join([value().to_bytes(size, "little", signed=is_signed) for value, size, is_signed in pdo.values])

    def _transmit_pdo(self, pdo: _TransmitPdo) -> None:
        pdo.last = self._encode_values(pdo)
        # Inhibit times are in 100 µs.
        pdo.free_ns = self._time.now_ns() + self._dictionary.get_value(pdo.parameter, 3) * 100 * NS_PER_US
        self._send(CanFrame(pdo.id, pdo.last))
        self._arm_event_timer(pdo)

    def _arm_event_timer(self, pdo: _TransmitPdo) -> None:
        if pdo.event is not None:
            pdo.event.cancel()
            pdo.event = None
        after_ms = self._dictionary.get_value(pdo.parameter, 5)
        if self._running and pdo.on and pdo.type >= _EVENT_FROM and after_ms:
            pdo.event = self._time.call_after(after_ms * NS_PER_MS, lambda: self._transmit_pdo(pdo))
