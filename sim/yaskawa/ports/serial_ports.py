"""Serial ports of the SMC-2000: the main one with echo, `%A` and `!`, and the general one (L829-L1011)."""

import re

from sim.yaskawa.base.data import LONGEST_LINE
from sim.yaskawa.language.statements import CompiledStatement, compile_line
from sim.yaskawa.ports.ports import PortSession
from sim.yaskawa.program.entry import OperatorEntry

BUFFER = 256
"""Characters that wait while the interpreter is blocked; further ones are lost, with error 5 (D13)."""
_ESCAPE = "\x1b"
ACCEPTED, MUTED = 1, 0
_COMMAND = re.compile(r'[^\r;"\n\x12]*[\r;]')
"""One command with its terminator, without characters of special meaning."""


class CommandPort(PortSession):
    """Port 1. Each command runs when its own terminator has arrived (D3), and the rest of a line runs after an error
    (D4).

    A controller of a daisy chain takes commands between its own `%A` and another's. All take a command with `!`;
    only address 0 echoes and answers it (L945-L949). A line that begins with `%` is echoed by the controller
    selected so far.
    """

    _muted = False
    _quoted = False
    _fresh = True
    """No character of the present line has arrived yet."""

    def receive_bytes(self, data: bytes) -> None:
        if not self.open:
            return
        machine = self.machine
        entry = machine.operator_input.entries["S"]
        text = data.decode("latin-1")
        is_whole = self._takes_whole(text, entry)
        self._fresh = self._fresh or is_whole
        if is_whole and machine.selected is False and not self._line and text.lstrip()[:1] not in ("%", "!"):
            return  # for another controller, as most of the bytes on a chain
        machine.advance_to_now()
        if is_whole:
            self._append_text(text[:-1])
            self._end_line(ACCEPTED)
            machine.run_ready()
            return
        for character in text:
            if machine.echo or machine.interrupting_on or entry.is_enabled:
                self._receive_character(character, entry)
            else:
                self._fresh = character in "\r;"
                self._packets.append((character, ACCEPTED))
                self.parse_input()
        self.parse_input()
        machine.run_ready()

    def _takes_whole(self, text: str, entry: OperatorEntry) -> bool:
        """Return whether `text` is a command that needs no character-by-character processing."""
        machine = self.machine
        return (
            not (machine.echo or machine.interrupting_on or entry.is_enabled or self._packets)
            and not (self._control or self._quoted or self._awaits_download() or self.download is not None)
            and _COMMAND.fullmatch(text) is not None
        )

    def _receive_character(self, character: str, entry: OperatorEntry) -> None:
        machine = self.machine
        if self._is_echoed(character):
            self.emit_text(character)
        mode = machine.interrupting["S"]
        if entry.is_enabled:
            if character in ("\\", _ESCAPE):
                entry.set_enabled(on=False)
                return
            entry.take_character(character)
        else:
            self._packets.append((character, ACCEPTED))
        if machine.interrupting_on and (mode == 2 or (mode == 1 and character == "\r")):
            machine.interrupting_on = not machine.programs.raise_event("COMINT")
        if not entry.is_enabled:
            self.parse_input()

    def _is_echoed(self, character: str) -> bool:
        broadcast = self._line.startswith("!") or (self._fresh and character == "!")
        machine = self.machine
        self._fresh = character in "\r;"
        if not machine.echo:
            return False
        return machine.address == 0 if broadcast else machine.selected is not False

    def _parse_piece(self, text: str, packet: int) -> None:
        if self.download is not None:
            self._collect_download(text, packet)
        elif text == "\n" or ((self._control or text == "\x12") and self._continue_control(text)):
            return
        elif text == "\r" or (text == ";" and not self._quoted):
            self._end_line(packet)
        else:
            self._quoted ^= text == '"'
            self._line = (self._line + text)[: LONGEST_LINE + 1]  # more would not be accepted either

    def _continue_control(self, character: str) -> bool:
        """Begin or continue a control sequence; return whether `character` belongs to it."""
        if character == "\x12":
            self._control = character if self.machine.selected is not False else ""
            return True
        return self._take_control(character)

    def _end_line(self, packet: int) -> None:
        self._quoted = False
        line, machine = self._line.strip(), self.machine
        if line.startswith("%"):
            self._select_address(line[1:].strip())
            return
        broadcast = line.startswith("!")
        if machine.selected is False and not broadcast:
            self._line = ""
            return
        packet = MUTED if broadcast and machine.address else ACCEPTED
        if sum(len(statement.text) for statement, _ in self.queue) > BUFFER:
            self._line = ""
            self._muted = packet == MUTED
            self.refuse_command(5)
            return
        self._line = ""
        if machine.operator_input.accept_input(self, line):
            return
        for statement in compile_line(line.removeprefix("!"), machine.model):
            self.queue.append((statement, packet))
        machine.interpreter.run_ready()

    def _select_address(self, address: str) -> None:
        """`%A`: select the controller with that address, which answers this (D7, D8)."""
        self._line = ""
        machine = self.machine
        machine.selected = address == str(machine.address)
        if machine.selected:
            self.queue.append((CompiledStatement("%", f"%{address}", lambda c: None), ACCEPTED))
            machine.interpreter.run_ready()

    def run_next(self) -> None:
        self._muted = bool(self.queue) and self.queue[0][1] == MUTED
        super().run_next()

    def _drop_rest(self, packet: int) -> None:
        """Keep the text after a refused command: it is further input (D4)."""

    def send_reply(self, text: str) -> None:
        if not self._muted:
            self.emit_text(text)
        self._muted = False

    def send_unsolicited(self, text: str) -> None:
        """Send unsolicited text; controllers that are not selected are silent (D9)."""
        if self.machine.selected is not False:
            self.emit_text(text)


class GeneralPort(PortSession):
    """Port 2 as a general port: an operator's panel, not a source of commands (L917-L931, L4807). Inactive before
    `CC`."""

    def receive_bytes(self, data: bytes) -> None:
        machine = self.machine
        baud, _, is_chained, echo = machine.second_line
        if not self.open or not baud or is_chained:
            return
        machine.advance_to_now()
        for character in data.decode("latin-1"):
            if echo:
                self.emit_text(character)
            self._receive_character(character)
        machine.run_ready()

    def _receive_character(self, character: str) -> None:
        machine = self.machine
        main = machine.programs.threads[0]
        if main.input_for and main.input_port == self.name:
            if character not in "\r;":
                self._append_text(character)
                return
            line, self._line = self._line, ""
            machine.operator_input.accept_input(self, line)
            return
        entry = machine.operator_input.entries["2"]
        if character in ("\\", _ESCAPE):
            entry.set_enabled(on=False)
            return
        if entry.is_enabled:
            entry.take_character(character)
        mode = machine.interrupting["2"]
        if machine.interrupting_on and (mode == 2 or (mode == 1 and character == "\r")):
            machine.interrupting_on = not machine.programs.raise_event("COMINT")
