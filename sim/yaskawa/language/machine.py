"""Parts of the machine as commands use them: settings, names of axes, formats, program control, ports, memory."""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from sim.yaskawa.base.formats import NumberFormat, NumberLayout
from sim.yaskawa.io.network import HandleSet
from sim.yaskawa.language.designators import AxisDesignators
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.trippoints import EventRaiser
from sim.yaskawa.program.editor import EditorPort, ProgramEditor
from sim.yaskawa.program.entry import OperatorEntry
from sim.yaskawa.program.threads import ProgramThread


class MachineSettings(Protocol):
    """Values that commands set, and that power-up and `RS` set to their defaults."""

    address: int
    retry_time: int
    echo: bool
    locked: int
    error_code: int
    unsolicited_port: str
    unsolicited_mode: int
    modbus_wait: bool
    polarity: list[int]
    system_letter: str
    gear_master: str
    last_encoder: int
    second_line: tuple[int, int, int, int]
    interrupting: dict[str, int]
    interrupting_on: bool
    selected: bool | None


class OperatorKeywords(Protocol):
    """Input of the serial ports, as programs read it."""

    @property
    def entries(self) -> Mapping[str, OperatorEntry]: ...

    def read_keyword(self, name: str) -> int:
        """`P1CH`, `P2NM`, …: return the value received on a serial port."""
        ...


class AxisNames(Protocol):
    """Axes by letter and by designator `~a`."""

    @property
    def letters(self) -> str: ...

    @property
    def designators(self) -> AxisDesignators: ...

    def find_axis(self, name: str) -> ServoAxis:
        """Return the axis of a designator; 4 when there is none."""
        ...


class AnswerFormats(Protocol):
    """Formats of the numbers in answers."""

    layout: NumberLayout
    position_format: NumberFormat
    variable_format: NumberFormat

    def format_variable(self, raw: int) -> str:
        """Format a number in the variable format."""
        ...

    def format_counts(self, counts: int) -> str:
        """Format a position in the position format."""
        ...

    def format_integer(self, number: int, digits: int) -> str:
        """Format an integer in a format of its own."""
        ...

    def format_answer(self, op: str, raw: int) -> str:
        """Format the answer to `op?` of a command that is not a parameter of axes."""
        ...


class ProgramControl(EventRaiser, Protocol):
    """The program threads as commands control them."""

    trace: bool
    break_at: tuple[int, int] | None
    break_hit: bool
    interrupts: int
    active_high: int
    interrupts_on: bool

    @property
    def threads(self) -> Sequence[ProgramThread]: ...

    @property
    def error_line(self) -> int: ...

    @property
    def error_thread(self) -> int: ...

    @property
    def error_index(self) -> int: ...

    def any_running(self) -> bool: ...

    def halt_all(self) -> None: ...

    def compiled_line(self, number: int) -> Sequence[object]:
        """Return the statements of a program line."""
        ...

    def jump_to(self, thread: ProgramThread, line: int) -> None:
        """Continue at `line`."""
        ...

    def count_loop(self, thread: ProgramThread) -> None:
        """Count a loop of `thread` in this sample."""
        ...

    def skip_block(self, thread: ProgramThread, *, to_else: bool) -> None:
        """Continue after the ELSE or ENDIF of the block that contains `thread`."""
        ...


class CommandOrigin(EditorPort, Protocol):
    """The port that a command came from."""

    @property
    def name(self) -> str: ...

    @property
    def kind(self) -> str: ...

    @property
    def host(self) -> tuple[int, int]:
        """Address and port of the host at its other end; zeros on a serial port."""
        ...

    download: Callable[[str], None] | None
    """Receives the whole text of a download at its end."""
    editor: ProgramEditor | None

    def accept_command(self, data: str | None) -> None:
        """Answer a valid command, with data or without."""
        ...

    def close_from_controller(self) -> None:
        """Close the connection from the controller's side."""
        ...


class OpenPorts(HandleSet, Protocol):
    """The connections of the controller, as commands use them."""

    @property
    def serial(self) -> CommandOrigin | None: ...

    @property
    def handles(self) -> Mapping[str, CommandOrigin]:
        """Ethernet handles that hosts have opened."""
        ...

    @property
    def lost_handle(self) -> int: ...

    def free_handles(self) -> list[str]:
        """Return the letters of the free handles."""
        ...

    def swap_handles(self, first: str, second: str) -> None:
        """`HS`."""
        ...

    def is_port_open(self, name: str) -> bool:
        """Return whether `MG` may name a port."""
        ...

    def send_message(self, text: str) -> None:
        """Send unsolicited text to the port that `CF` names."""
        ...

    def send_text(self, name: str, text: str) -> None:
        """Send text to one port; it is lost when the port is not open."""
        ...


class NonvolatileMemory(Protocol):
    """The EEPROM as the burning commands use it."""

    password: str

    def burn_parameters(self) -> None: ...

    def burn_period(self, period_us: int) -> None: ...

    def burn_lock(self) -> None: ...

    def burn_program(self) -> None: ...

    def burn_variables(self) -> None: ...

    def discard_parameters(self) -> None: ...

    def restore_parameters(self) -> None: ...
