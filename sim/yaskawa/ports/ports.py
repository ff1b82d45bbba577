"""Ports: bytes in, prompts out (L1624-L1705, L1719-L1822)."""

from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from orchestrator.link.supply import Supply
from sim.core.controller import PortRefused, Send
from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.statements import Raw, Statement, compile_line, finished
from sim.yaskawa.motion.trippoints import Trip
from sim.yaskawa.ports.network import Peer
from sim.yaskawa.program.editor import Editor

if TYPE_CHECKING:
    from sim.yaskawa.machine import Machine

LONGEST_LINE = 80
LONGEST_PACKET = 470
ENDS = "\x1a\x11\x04\\"
"""What ends a download: ctrl-Z, ctrl-Q, ctrl-D, backslash (L4134)."""
END_OF_TEXT = "\x1a"
"""Behind an uploaded program or array."""
_TAKING = ("DL", "QD", "ED", "RS")
"""Commands that decide what the next bytes are."""
SILENCE_NS = 600_000_000_000

Download = Callable[[str], None]
"""Takes the whole text of a download when it ends; may raise `CommandError`."""


class Port:
    """One open connection: `S` is the serial port, `A` to `H` are Ethernet handles."""

    supply = Supply()

    def __init__(self, owner: "Ports", name: str, kind: str, send: Send, closed: Callable[[], None]) -> None:
        self.owner = owner
        self.machine = owner.machine
        self.name = name
        self.kind = kind
        self.send = send
        self.closed = closed
        self.open = True
        self.queue: deque[tuple[Statement, int]] = deque()
        self.trip: Trip | None = None
        self.download: Download | None = None
        self.editor: Editor | None = None
        self.heard_ns = self.machine.timebase.clock.now_ns()
        self.context = Context(self.machine, None, self)
        self._line = ""
        self._ended = 0
        """Characters of the line that have been run already."""
        self._packets: deque[tuple[str, int]] = deque()
        self._packet = 0
        self._loading = ""
        self._overlong = False
        self._control = False

    # Bytes in

    def receive(self, data: bytes) -> None:
        """Bytes have arrived, now (a packet on Ethernet)."""
        if not self.open:
            return
        machine = self.machine
        machine.look()
        self.heard_ns = machine.timebase.clock.now_ns()
        text = data.decode("latin-1")
        self._packet += 1
        if self.kind != "serial" and len(data) > LONGEST_PACKET:
            self.refuse(122)
        else:
            if self.kind == "serial":
                machine.serial_arrived(text)
                if machine.echo:
                    self.emit(text.replace("\x12", "").replace("\r", "\r\n"))
            self._packets.append((text, self._packet))
            self.feed()
        if self.owner.strict_packets and self.kind != "serial":
            self._line, self._ended = "", 0
        if self.kind == "serial" or not machine.interpreter.busy:
            machine.go_on()

    def feed(self) -> None:
        """Take apart what has arrived, as far as nothing has to be run first."""
        while self._packets and not self._holds():
            text, packet = self._packets.popleft()
            if not text:
                continue
            if self.download is not None:
                self._load(text, packet)
            elif self.editor is not None:
                self.editor = self.editor if self.editor.take(text[0]) else None
                if len(text) > 1:
                    self._packets.appendleft((text[1:], packet))
            elif self._control or any(mark in text for mark in "\x12\\"):
                self._take(text[0], packet)
                if len(text) > 1 and self.open:
                    self._packets.appendleft((text[1:], packet))
            else:
                head, found, rest = text.partition("\r")
                self._append(head)
                if rest:
                    self._packets.appendleft((rest, packet))
                if found:
                    self._end_line(packet)
                else:
                    self._end_statements(packet)

    def _holds(self) -> bool:
        """Whether a download that has been asked for decides what the next bytes are."""
        if self.download is not None or not self.queue:
            return False
        return any(statement.op in _TAKING for statement, _ in self.queue)

    def _take(self, character: str, packet: int) -> None:
        if self._control:
            self._control = False
            if character == "\x13":
                self.machine.master_reset(self)
            elif character in "\x15\x16":
                self.emit(f"{self.machine.revision}\r\n:")
            return
        if character == "\x12":
            self._control = True
        elif character == "\\":
            self._line, self._ended, self._overlong = "", 0, False
        elif character == "\r":
            self._end_line(packet)
        else:
            self._append(character)

    def _append(self, text: str) -> None:
        if "\n" in text:
            text = text.replace("\n", "")
        self._line += text
        if self._ended + len(self._line) > LONGEST_LINE:
            self._overlong, self._line = True, self._line[:LONGEST_LINE]

    def _end_statements(self, packet: int) -> None:
        """What a semicolon has ended does not wait for the carriage return (L1624, L12230)."""
        done = finished(self._line, self.machine.model) if ";" in self._line and not self._overlong else 0
        if done:
            line, self._line = self._line[: done - 1], self._line[done:]
            self._ended += done
            self._run(line, packet, ";")

    def _end_line(self, packet: int) -> None:
        line, self._line, self._ended = self._line, "", 0
        if self._overlong:
            self._overlong = False
            self.refuse(5)
            return
        self._run(line, packet, "\r")

    def _run(self, line: str, packet: int, end: str) -> None:
        """Have the statements of a line run; what stands behind one that takes the next bytes is taken by it."""
        if self.machine.take_input(self, line):
            return
        if self.kind == "serial":
            self._packet += 1
            packet = self._packet
        statements = compile_line(line, self.machine.model)
        for index, statement in enumerate(statements, start=1):
            self.queue.append((statement, packet))
            if statement.op in _TAKING:
                tail = ";".join(later.text for later in statements[index:])
                self._packets.appendleft((tail + end + self._line if tail else self._line, packet))
                self._line = ""
                break
        self.machine.interpreter.pump()

    def _load(self, text: str, packet: int) -> None:
        """Collect a download up to its end."""
        ends = [place for mark in ENDS if (place := text.find(mark)) >= 0]
        if not ends:
            self._loading += text
            return
        end = min(ends)
        loaded, self._loading = self._loading + text[:end], ""
        download, self.download = self.download, None
        if text[end + 1 :]:
            self._packets.appendleft((text[end + 1 :], packet))
        try:
            if download is not None:
                download(loaded)
        except CommandError as error:
            self.refuse(error.code)
        else:
            self.emit(":")

    # Commands

    def run_next(self) -> None:
        """Run the next command, and answer it."""
        if not self.queue:
            return
        statement, packet = self.queue.popleft()
        try:
            outcome = statement.execute(self.context)
        except CommandError as error:
            self._drop(packet)
            self.refuse(error.code)
        else:
            if isinstance(outcome, Trip):
                if outcome.passed(self.machine, self.machine.now()):
                    self.accept(None)
                else:
                    self.trip = outcome
            elif self.download is None and self.editor is None and self.open:
                if isinstance(outcome, Raw):
                    self.answer(f"{outcome}:")
                else:
                    self.accept(outcome)
        if self._packets:
            self.feed()

    def _drop(self, packet: int) -> None:
        """What came in the packet (on the serial port: in the line) of a refused command is not looked at (D6)."""
        self.queue = deque(item for item in self.queue if item[1] != packet)
        if self.kind != "serial":
            if any(number == packet for _, number in self._packets) or packet == self._packet:
                self._line = ""
            self._packets = deque(item for item in self._packets if item[1] != packet)

    # Bytes out

    def accept(self, data: str | None) -> None:
        """Answer a valid command, with data or without."""
        self.answer(":" if data is None else f"{data}\r\n:")

    def refuse(self, code: int) -> None:
        """Answer an invalid command."""
        self.machine.fail(code)
        self.answer("?\r\n" if self.machine.question_crlf else "?")

    def answer(self, text: str) -> None:
        """The reply to a command."""
        self.emit(text)

    def unsolicited(self, text: str) -> None:
        """Text that nobody on this port has asked for."""
        self.emit(text)

    def emit(self, text: str) -> None:
        if not self.open or not text:
            return
        data = text.encode("latin-1", "replace")
        if self.kind != "udp" or len(data) <= LONGEST_PACKET:
            self.send(data)
            return
        for start in range(0, len(data), LONGEST_PACKET):
            self.send(data[start : start + LONGEST_PACKET])

    # The end

    def close(self) -> None:
        """The other side has gone."""
        if self.open:
            self.open = False
            self.owner.gone(self, lost=True)

    def hang_up(self) -> None:
        """The controller ends the connection."""
        if self.open:
            self.open = False
            self.owner.gone(self, lost=False)
            self.closed()


class Ports:
    """All connections of one controller."""

    def __init__(self, machine: "Machine") -> None:
        self.machine = machine
        self.serial: Port | None = None
        self.second: Port | None = None
        self.strict_packets = False
        self.handles: dict[str, Port] = {}
        self.first_handle = ""
        self.outgoing: dict[str, Peer] = {}
        """Handles that this controller has opened itself."""
        self.lost_handle = -1
        self._all: tuple[Port, ...] = ()

    def all(self) -> Iterable[Port]:
        """Every open connection."""
        return self._all

    def connect(self, port: str, send: Send, closed: Callable[[], None]) -> Port:
        """Open a connection; `PortRefused` when there is no such port or it has no place left."""
        if port not in self.machine.model.ports:
            raise PortRefused(f"no port {port!r}; this model has {', '.join(self.machine.model.ports)}")
        if not self.machine.powered:
            raise PortRefused("the controller is switched off")
        if port == "serial":
            if self.serial is not None:
                raise PortRefused("the serial port is in use")
            self.serial = opened = self.machine.model.serial_port(self, "S", port, send, closed)
        elif port == "serial2":
            if self.second is not None:
                raise PortRefused("the second serial port is in use")
            self.second = opened = self.machine.model.second_port(self, "2", "serial", send, closed)
        else:
            self._forget_silent()
            name = self.first_handle or next(iter(self.free_handles()), "")
            if not name:
                raise PortRefused("no Ethernet handle is left (L1777)")
            self.first_handle = ""
            self.handles[name] = opened = Port(self, name, port, send, closed)
        self._refresh()
        return opened

    def free_handles(self) -> list[str]:
        """Letters of the handles that are free."""
        return [name for name in self.machine.model.handles if name not in self.handles and name not in self.outgoing]

    def gone(self, port: Port, *, lost: bool) -> None:
        """Forget a connection; a TCP connection that the other side has lost may call #TCPERR."""
        if port is self.serial:
            self.serial = None
        elif port is self.second:
            self.second = None
        elif self.handles.get(port.name) is port:
            del self.handles[port.name]
            if port.kind == "tcp" and lost and self.machine.powered:
                self.connection_lost(port.name)
        self._refresh()
        if self.machine.powered:
            self.machine.go_on()

    def connection_lost(self, handle: str) -> None:
        """A TCP connection has gone without the controller's doing: `_IA4`, #TCPERR (L5778, L15514)."""
        self.lost_handle = ord(handle) - ord("A")
        self.machine.interpreter.raise_event("TCPERR")

    def drop_all(self) -> None:
        """Power is gone, or a hardware reset."""
        for port in tuple(self._all):
            port.hang_up()
        peers, self.outgoing = tuple(self.outgoing.values()), {}
        for peer in peers:
            peer.close()

    def swap(self, first: str, second: str) -> None:
        """`HS` (L5635)."""
        ports = {name: self.handles.pop(name, None) for name in (first, second)}
        peers = {name: self.outgoing.pop(name, None) for name in (first, second)}
        for name, other in ((first, second), (second, first)):
            port, peer = ports[other], peers[other]
            if port is not None:
                port.name = name
                self.handles[name] = port
            if peer is not None:
                peer.handle = name
                self.outgoing[name] = peer
        self._refresh()

    def message(self, text: str) -> None:
        """Unsolicited text, to the port that `CF` names (L3556); `CW 1` marks its characters (L3930)."""
        self.tell(self.machine.unsolicited_port, text)

    def opened(self, name: str) -> bool:
        """Whether `MG` may name a port: the serial ones always, a handle when somebody is on it (L10421)."""
        return name not in self.machine.model.handles or name in self.handles or name in self.outgoing

    def tell(self, name: str, text: str) -> None:
        """Text for one port; it is lost when the port is not open."""
        if name == "2" and "serial2" not in self.machine.model.ports:
            name = "S"
        port = self.serial if name == "S" else self.second if name == "2" else self.handles.get(name)
        peer = self.outgoing.get(name)
        if peer is not None:
            peer.send(text.encode("latin-1", "replace"))
        if port is not None:
            if self.machine.mark_unsolicited:
                text = "".join(chr(ord(character) | 0x80) for character in text)
            port.unsolicited(text)

    def _forget_silent(self) -> None:
        now_ns = self.machine.timebase.clock.now_ns()
        for port in tuple(self.handles.values()):
            if port.kind == "udp" and now_ns - port.heard_ns > SILENCE_NS:
                port.hang_up()

    def _refresh(self) -> None:
        opened = [port for port in (self.serial, self.second) if port is not None]
        self._all = (*opened, *self.handles.values())


def address_text(address: int) -> str:
    """An IP address, kept as a signed 32-bit number, as `a,b,c,d`."""
    bits = fixed.wrapped(address) & 0xFFFFFFFF
    return ",".join(str(bits >> shift & 255) for shift in (24, 16, 8, 0))
