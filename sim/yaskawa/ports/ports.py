"""Ports: bytes in, prompts out (L1624-L1705, L1719-L1822)."""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Protocol

from orchestrator.link.supply import PowerSupply
from sim.core.controller import PortRefused, SendBytes
from sim.yaskawa.base import fixed
from sim.yaskawa.base.data import LONGEST_LINE
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.io.network import PeerHandle
from sim.yaskawa.language.context import CommandContext, CommandMachine
from sim.yaskawa.language.machine import CommandOrigin, OperatorKeywords
from sim.yaskawa.language.model import LanguageModel
from sim.yaskawa.language.statements import CompiledStatement, RawData, compile_line, finished_length
from sim.yaskawa.motion.trippoints import TripPoint
from sim.yaskawa.program.editor import ProgramEditor

LONGEST_PACKET = 470
"""Bytes of a datagram (L1735). What TCP delivers at once is no packet of the sender's."""
ENDS = "\x1a\x11\x04\\"
"""Characters that end a download: ctrl-Z, ctrl-Q, ctrl-D, backslash (L4134)."""
END_OF_TEXT = "\x1a"
"""Terminator of an uploaded program or array."""
_TAKING = ("DL", "QD", "ED", "RS")
"""Commands that define the meaning of the next bytes."""
HOST_ADDRESS = -1062731519
"""192.168.1.1 as `_IHh0` reports it: the host of all connections, unless `PortSet.host_address` is set."""
FIRST_HOST_PORT = 49152
SILENCE_NS = 600_000_000_000

Download = Callable[[str], None]
"""Receives the whole text of a download at its end; may raise `CommandError`."""


class PortInterpreter(Protocol):
    """The interpreter as ports see it."""

    @property
    def busy(self) -> bool:
        """Whether it decodes a command now."""
        ...

    def run_ready(self) -> None:
        """Run all that is ready."""
        ...


class PortInput(OperatorKeywords, Protocol):
    """Input of programs as ports deliver it."""

    def accept_input(self, port: CommandOrigin, line: str) -> bool:
        """Return whether `line` answers an IN."""
        ...

    def store_serial_input(self, text: str) -> None:
        """Store the last character for `P1CH`."""
        ...


class PortMachine(CommandMachine, Protocol):
    """The machine as its ports see it."""

    @property
    def model(self) -> LanguageModel: ...

    @property
    def interpreter(self) -> PortInterpreter: ...

    @property
    def powered(self) -> bool: ...

    @property
    def question_crlf(self) -> bool: ...

    @property
    def mark_unsolicited(self) -> bool: ...

    @property
    def operator_input(self) -> PortInput: ...

    def master_reset(self, port: "PortSession") -> None:
        """Ctrl-R ctrl-S: factory state, burned values erased."""
        ...


PortMaker = Callable[["PortSet", str, str, SendBytes, Callable[[], None]], "PortSession"]
"""Makes a port from its owner, name and kind, and from what sends its bytes and reports its end."""


class PortSession:
    """One open connection: `S` is the serial port, `A` to `H` are Ethernet handles."""

    supply = PowerSupply()

    def __init__(self, owner: "PortSet", name: str, kind: str, send: SendBytes, closed: Callable[[], None]) -> None:
        self.owner = owner
        self.machine = owner.machine
        self.name = name
        self.kind = kind
        self.send = send
        self.closed = closed
        self.open = True
        self.host: tuple[int, int] = (0, 0)
        """Address and port of the host at its other end, for an Ethernet handle."""
        self.queue: deque[tuple[CompiledStatement, int]] = deque()
        self.trip: TripPoint | None = None
        self.download: Download | None = None
        self.editor: ProgramEditor | None = None
        self.last_receive_ns = self.machine.timebase.clock.now_ns()
        self.context = CommandContext(self.machine, None, self)
        self._line = ""
        """Characters that no terminator has ended yet."""
        self._packets: deque[tuple[str, int]] = deque()
        self._packet = 0
        self._loading = ""
        self._parsing = False
        self._control = ""
        """The control sequence in progress: ctrl-R alone, or the whole of one whose terminator may follow."""

    # Input

    def receive_bytes(self, data: bytes) -> None:
        """Process bytes that arrive now (a packet on Ethernet)."""
        if not self.open:
            return
        machine = self.machine
        machine.advance_to_now()
        self.last_receive_ns = machine.timebase.clock.now_ns()
        text = data.decode("latin-1")
        self._packet += 1
        if self.kind == "udp" and len(data) > LONGEST_PACKET:
            self.refuse_command(122)
        else:
            if self.kind == "serial":
                machine.operator_input.store_serial_input(text)
                if machine.echo:
                    self.emit_text(text.replace("\x12", "").replace("\r", "\r\n"))
            if text:
                self._packets.append((text, self._packet))
            self.parse_input()
        if self.owner.strict_packets and self.kind != "serial":
            self._line = ""
        if self.kind == "serial" or not machine.interpreter.busy:
            machine.run_ready()

    def parse_input(self) -> None:
        """Parse the received bytes, until a command has to run first. A command that runs meanwhile leaves the rest to
        the call in progress."""
        if self._parsing:
            return
        self._parsing = True
        try:
            while self._packets and not self._awaits_download():
                self._parse_piece(*self._packets.popleft())
        finally:
            self._parsing = False

    def _parse_piece(self, text: str, packet: int) -> None:
        """Parse the beginning of a piece of input that is not empty; the rest becomes the next piece."""
        if self.download is not None:
            self._collect_download(text, packet)
        elif self.editor is not None:
            self.editor = self.editor if self.editor.take_character(text[0]) else None
            if len(text) > 1:
                self._packets.appendleft((text[1:], packet))
        elif self._control or any(mark in text for mark in "\x12\\"):
            self._take_character(text[0], packet)
            if len(text) > 1 and self.open:
                self._packets.appendleft((text[1:], packet))
        else:
            head, mark, tail = text.partition("\r")
            self._append_text(head)
            if tail:
                self._packets.appendleft((tail, packet))
            if mark:
                self._end_line(packet)
            else:
                self._end_statements(packet)

    def _awaits_download(self) -> bool:
        """Return whether a pending download command defines the meaning of the next bytes."""
        if self.download is not None or not self.queue:
            return False
        return any(statement.op in _TAKING for statement, _ in self.queue)

    def _take_character(self, character: str, packet: int) -> None:
        if self._control and self._take_control(character):
            return
        if character == "\x12":
            self._control = character
        elif character == "\\":
            self._line = ""
        elif character == "\r":
            self._end_line(packet)
        else:
            self._append_text(character)
            self._end_statements(packet)

    def _take_control(self, character: str) -> bool:
        """Continue a control sequence (D33); return whether `character` belongs to it."""
        control, self._control = self._control, ""
        if control == "\x12":
            self._control = control + character
            if self.machine.options.control_end != "required":
                self._run_control(character)
            if self.machine.options.control_end == "separate":
                self._control = ""
            return True
        if character not in "\r;":
            return False
        if self.machine.options.control_end == "required":
            self._run_control(control[1])
        return True

    def _run_control(self, character: str) -> None:
        if character == "\x13":
            self.machine.master_reset(self)
        elif character in "\x15\x16":
            self.emit_text(f"{self.machine.revision_text}\r\n:")

    def _append_text(self, text: str) -> None:
        self._line += text.replace("\n", "")

    def _end_statements(self, packet: int) -> None:
        """Run the statements ended by a semicolon, without waiting for the carriage return (L1624, L12230)."""
        done_length = finished_length(self._line, self.machine.model) if ";" in self._line else 0
        if done_length:
            line, self._line = self._line[: done_length - 1], self._line[done_length:]
            self._queue_line(line, packet, ";")
        self._line = self._line[: LONGEST_LINE + 1]  # more would not be accepted either

    def _end_line(self, packet: int) -> None:
        line, self._line = self._line, ""
        self._queue_line(line, packet, "\r")

    def _queue_line(self, line: str, packet: int, end: str) -> None:
        """Queue the statements of a line; text after a command that takes the next bytes is consumed by it."""
        if self.machine.operator_input.accept_input(self, line):
            return
        if self.kind == "serial":
            self._packet += 1
            packet = self._packet
        statements = compile_line(line, self.machine.model)
        for index, statement in enumerate(statements, start=1):
            self.queue.append((statement, packet))
            if statement.op in _TAKING:
                tail = ";".join(statement.text for statement in statements[index:])
                remainder, self._line = (tail + end if tail else "") + self._line, ""
                if remainder:
                    self._packets.appendleft((remainder, packet))
                break
        self.machine.interpreter.run_ready()

    def _collect_download(self, text: str, packet: int) -> None:
        """Collect a download up to its end."""
        ends = [index for mark in ENDS if (index := text.find(mark)) >= 0]
        if not ends:
            self._loading += text
            return
        end = min(ends)
        program, self._loading = self._loading + text[:end], ""
        download, self.download = self.download, None
        if text[end + 1 :]:
            self._packets.appendleft((text[end + 1 :], packet))
        try:
            if download is not None:
                download(program)
        except CommandError as error:
            self.refuse_command(error.code)
        else:
            self.emit_text(":")

    # Commands

    def run_next(self) -> None:
        """Run the next command, and answer it."""
        if not self.queue:
            return
        statement, packet = self.queue.popleft()
        try:
            outcome = statement.run_statement(self.context)
        except CommandError as error:
            self._drop_rest(packet)
            self.refuse_command(error.code)
        else:
            if isinstance(outcome, TripPoint):
                if outcome.passed(self.machine, self.machine.current_sample()):
                    self.accept_command(None)
                else:
                    self.trip = outcome
            elif self.download is None and self.editor is None and self.open:
                if isinstance(outcome, RawData):
                    self.send_reply(f"{outcome}:")
                else:
                    self.accept_command(outcome)
        if self._packets:
            self.parse_input()

    def _drop_rest(self, packet: int) -> None:
        """Drop the rest of the packet (on the serial port: of the line) of a refused command (D6)."""
        self.queue = deque(item for item in self.queue if item[1] != packet)
        if self.kind != "serial":
            if any(number == packet for _, number in self._packets) or packet == self._packet:
                self._line = ""
            self._packets = deque(item for item in self._packets if item[1] != packet)

    # Output

    def accept_command(self, data: str | None) -> None:
        """Answer a valid command, with data or without."""
        self.send_reply(":" if data is None else f"{data}\r\n:")

    def refuse_command(self, code: int) -> None:
        """Answer an invalid command."""
        self.machine.refuse_command(code)
        self.send_reply("?\r\n" if self.machine.question_crlf else "?")

    def send_reply(self, text: str) -> None:
        """Send the reply to a command."""
        self.emit_text(text)

    def send_unsolicited(self, text: str) -> None:
        """Send text that no command on this port has requested."""
        self.emit_text(text)

    def emit_text(self, text: str) -> None:
        if not self.open or not text:
            return
        data = text.encode("latin-1", "replace")
        if self.kind != "udp" or len(data) <= LONGEST_PACKET:
            self.send(data)
            return
        for start in range(0, len(data), LONGEST_PACKET):
            self.send(data[start : start + LONGEST_PACKET])

    # End of the connection

    def close(self) -> None:
        """Handle a disconnection by the remote end."""
        if self.open:
            self.open = False
            self.owner.remove_port(self, was_lost=True)

    def close_from_controller(self) -> None:
        """Close the connection from the controller's side."""
        if self.open:
            self.open = False
            self.owner.remove_port(self, was_lost=False)
            self.closed()


class PortSet:
    """All connections of one controller."""

    def __init__(self, machine: PortMachine, serial_port: PortMaker, second_port: PortMaker) -> None:
        self.machine = machine
        self._serial_port, self._second_port = serial_port, second_port
        self.serial: PortSession | None = None
        self.second: PortSession | None = None
        self.strict_packets = False
        self.handles: dict[str, PortSession] = {}
        self.first_handle = ""
        self.outgoing: dict[str, PeerHandle] = {}
        """Handles that this controller has opened itself."""
        self.host_address = HOST_ADDRESS
        """Address of the hosts that connect from now on."""
        self._next_port = FIRST_HOST_PORT
        self.lost_handle = -1
        self._all: tuple[PortSession, ...] = ()

    def open_ports(self) -> Iterable[PortSession]:
        """Return every open connection."""
        return self._all

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortSession:
        """Open a connection; raises `PortRefused` when there is no such port or no free handle."""
        if port not in self.machine.model.ports:
            raise PortRefused(f"no port {port!r}; this model has {', '.join(self.machine.model.ports)}")
        if not self.machine.powered:
            raise PortRefused("the controller is switched off")
        if port == "serial":
            if self.serial is not None:
                raise PortRefused("the serial port is in use; close the other connection first")
            self.serial = opened_port = self._serial_port(self, "S", port, send, closed)
        elif port == "serial2":
            if self.second is not None:
                raise PortRefused("the second serial port is in use; close the other connection first")
            self.second = opened_port = self._second_port(self, "2", "serial", send, closed)
        else:
            self._forget_silent()
            name = self.first_handle or next(iter(self.free_handles()), "")
            if not name:
                raise PortRefused("no Ethernet handle is free (L1777); close another connection first")
            self.first_handle = ""
            self.handles[name] = opened_port = PortSession(self, name, port, send, closed)
            opened_port.host = (self.host_address, self._next_port)
            self._next_port += 1
        self._list_ports()
        return opened_port

    def free_handles(self) -> list[str]:
        """Return the letters of the free handles."""
        return [name for name in self.machine.model.handles if name not in self.handles and name not in self.outgoing]

    def remove_port(self, port: PortSession, *, was_lost: bool) -> None:
        """Remove a connection; a TCP connection that the remote end has lost may call #TCPERR."""
        if port is self.serial:
            self.serial = None
        elif port is self.second:
            self.second = None
        elif self.handles.get(port.name) is port:
            del self.handles[port.name]
            if port.kind == "tcp" and was_lost and self.machine.powered:
                self.handle_connection_loss(port.name)
        self._list_ports()
        if self.machine.powered:
            self.machine.run_ready()

    def handle_connection_loss(self, handle: str) -> None:
        """Handle a TCP connection lost without action of the controller: `_IA4`, #TCPERR (L5778, L15514)."""
        self.lost_handle = ord(handle) - ord("A")
        self.machine.programs.raise_event("TCPERR")

    def drop_all(self) -> None:
        """Drop all connections after a power loss or a hardware reset."""
        for port in tuple(self._all):
            port.close_from_controller()
        peers, self.outgoing = tuple(self.outgoing.values()), {}
        for peer in peers:
            peer.close_handle()

    def swap_handles(self, first: str, second: str) -> None:
        """`HS` (L5635)."""
        ports = {name: self.handles.pop(name, None) for name in (first, second)}
        peers = {name: self.outgoing.pop(name, None) for name in (first, second)}
        for name, other_name in ((first, second), (second, first)):
            port, peer = ports[other_name], peers[other_name]
            if port is not None:
                port.name = name
                self.handles[name] = port
            if peer is not None:
                peer.handle = name
                self.outgoing[name] = peer
        self._list_ports()

    def send_message(self, text: str) -> None:
        """Send unsolicited text to the port that `CF` names (L3556); `CW 1` marks its characters (L3930)."""
        self.send_text(self.machine.unsolicited_port, text)

    def is_port_open(self, name: str) -> bool:
        """Return whether `MG` may name a port: the serial ones always, a handle when it is connected (L10421)."""
        return name not in self.machine.model.handles or name in self.handles or name in self.outgoing

    def send_text(self, name: str, text: str) -> None:
        """Send text to one port; it is lost when the port is not open."""
        if name == "2" and "serial2" not in self.machine.model.ports:
            name = "S"
        port = self.serial if name == "S" else self.second if name == "2" else self.handles.get(name)
        peer = self.outgoing.get(name)
        if peer is not None:
            peer.send_bytes(text.encode("latin-1", "replace"))
        if port is not None:
            if self.machine.mark_unsolicited:
                text = "".join(chr(ord(character) | 0x80) for character in text)
            port.send_unsolicited(text)

    def _forget_silent(self) -> None:
        now_ns = self.machine.timebase.clock.now_ns()
        for port in tuple(self.handles.values()):
            if port.kind == "udp" and now_ns - port.last_receive_ns > SILENCE_NS:
                port.close_from_controller()

    def _list_ports(self) -> None:
        opened_sessions = [port for port in (self.serial, self.second) if port is not None]
        self._all = (*opened_sessions, *self.handles.values())


def address_text(address: int) -> str:
    """Format an IP address, stored as a signed 32-bit number, as `a,b,c,d`."""
    bits = fixed.wrap_counts(address) & 0xFFFFFFFF
    return ",".join(str(bits >> shift & 255) for shift in (24, 16, 8, 0))
