"""A simulated CAN bus at a pseudo-terminal, in the protocol of a serial CAN adapter: LAWICEL's "slcan".

Commands and answers are lines that end with CR; an unknown or impossible command is answered with BEL.
"""

from collections.abc import Callable
from pathlib import Path

from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.link.can import ERROR_BUS_OFF, CanFrame
from orchestrator.link.can_bus import CanNode, MemoryCanBus
from orchestrator.link.supply import PowerSupply
from sim.core.controller import PortConnection, PortRefused, SendBytes
from sim.link.can_card import RESTART_NS, CanSegment
from sim.link.pty import PORT, PtyServer

BIT_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Bit rates of the commands S0 to S8."""
LONGEST_LINE = 32
_OK, _BELL = b"\r", b"\a"
_PASSIVE_FLAG, _ERROR_FLAG = 0x20, 0x80

# Such adapters are USB devices: the bus limits them, not the baud rate that the port is opened with.
_BAUD = 12_000_000
_CHARACTER_BITS = 10


class _SlcanAdapter:
    """One client of the adapter. It is a node of the bus while its channel is open, and has its power from the host."""

    supply = PowerSupply()

    def __init__(self, bus: MemoryCanBus, clock: Clock, send: SendBytes) -> None:
        self._bus = bus
        self._clock = clock
        self._send = send
        self._line = b""
        self._node: CanNode | None = None
        self._bitrate = bus.bitrate
        self._listens_only = self._stamps = self._failed = False
        self._commands: dict[bytes, Callable[[bytes], bytes]] = {
            b"S": self._set_bit_rate,
            b"O": self._open_channel,
            b"L": self._open_listen_only,
            b"C": self._close_channel,
            b"Z": self._set_stamps,
            b"F": self._read_flags,
            b"V": lambda _: b"V1010\r",
            b"N": lambda _: b"NTUT1\r",
        }

    def receive_bytes(self, data: bytes) -> None:
        for byte in data:
            if byte == 0x0D:
                line, self._line = self._line, b""
                self._send(self._answer_line(line))
            elif len(self._line) < LONGEST_LINE:
                self._line += bytes([byte])

    def close(self) -> None:
        if self._node is not None:
            self._bus.detach_node(self._node)
            self._node = None

    def _answer_line(self, line: bytes) -> bytes:
        command, fields = line[:1], line[1:]
        try:
            if command in b"tTrR" and command:
                return self._transmit_frame(command, fields)
            return self._commands[command](fields)
        except (KeyError, ValueError, IndexError):
            return _BELL

    # Commands

    def _set_bit_rate(self, rest: bytes) -> bytes:
        if self._node is not None:
            return _BELL
        self._bitrate = BIT_RATES[int(rest)]
        return _OK

    def _open_channel(self, rest: bytes) -> bytes:
        if rest or self._node is not None:
            return _BELL
        self._listens_only = self._failed = False
        self._node = self._bus.attach_node(self._forward_frame, self._handle_bus_error, bitrate=self._bitrate)
        return _OK

    def _open_listen_only(self, rest: bytes) -> bytes:
        answer = self._open_channel(rest)
        self._listens_only = answer == _OK
        return answer

    def _close_channel(self, rest: bytes) -> bytes:
        if rest or self._node is None:
            return _BELL
        self.close()
        return _OK

    def _set_stamps(self, rest: bytes) -> bytes:
        if self._node is not None or rest not in (b"0", b"1"):
            return _BELL
        self._stamps = rest == b"1"
        return _OK

    def _read_flags(self, rest: bytes) -> bytes:
        if rest or self._node is None:
            return _BELL
        flags = _PASSIVE_FLAG * (self._node.node_state == "passive") | _ERROR_FLAG * self._failed
        self._failed = False
        return b"F%02X\r" % flags

    def _transmit_frame(self, command: bytes, rest: bytes) -> bytes:
        is_extended, remote = command in b"TR", command in b"rR"
        digits = 8 if is_extended else 3
        length = int(rest[digits : digits + 1], 16)
        data = bytes(length) if remote else bytes.fromhex(rest[digits + 1 :].decode("ascii"))
        if self._node is None or self._listens_only or len(data) != length:
            return _BELL
        self._node.queue_frames(CanFrame(int(rest[:digits], 16), data, is_extended, remote))
        return b"Z\r" if is_extended else b"z\r"

    # The bus

    def _forward_frame(self, frame: CanFrame) -> None:
        head = ("R" if frame.rtr else "T") if frame.extended else ("r" if frame.rtr else "t")
        name = f"{frame.id:08X}" if frame.extended else f"{frame.id:03X}"
        data = "" if frame.rtr else frame.data.hex().upper()
        stamp = f"{self._clock.now_ns() // NS_PER_MS % 60_000:04X}" if self._stamps else ""
        self._send(f"{head}{name}{len(frame.data)}{data}{stamp}\r".encode())

    def _handle_bus_error(self, what: int) -> None:
        self._failed = True
        if what == ERROR_BUS_OFF and self._node is not None:
            self._bus.schedule_call(RESTART_NS, self._node.leave_bus_off)


class _SlcanPort:
    """The adapter's serial port."""

    def __init__(self, segment: CanSegment, clock: Clock) -> None:
        self._segment = segment
        self._clock = clock

    @property
    def port_names(self) -> tuple[str, ...]:
        return (PORT,)

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        """Raises `PortRefused`."""
        del closed
        if port != PORT:
            raise PortRefused(f"no port {port!r}; a serial CAN adapter has {PORT}")
        return _SlcanAdapter(self._segment.bus, self._clock, send)


class CanPtyServer(PtyServer):
    """Serve a bus on a pseudo-terminal that `link` points to. Raises `OSError` when the link cannot be made."""

    def __init__(self, segment: CanSegment, clock: Clock, link: Path) -> None:
        super().__init__(_SlcanPort(segment, clock), clock, link, _BAUD, _CHARACTER_BITS)

    @property
    def ready_fields(self) -> dict[str, object]:
        """Address fields for the ready line."""
        channel = super().ready_fields["device"]
        return {"place": f"can {channel}", "kind": "can", "interface": "slcan", "channel": channel}
