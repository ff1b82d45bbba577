"""A loaded move and its progress."""

from dataclasses import dataclass, field

from adapters.contract import HostInterval, TimedWrite
from adapters.shrc203.lowering import ShrcLowered
from adapters.shrc203.output import ShrcOutput
from adapters.shrc203.wire.replies import AxisStatus
from adapters.shrc203.wire.reply_queue import ShrcPending
from adapters.toolkit.driven_output import DrivenOutput


@dataclass(slots=True)
class ArmedMove:
    """A loaded move.

    output: the output that it switches.
    released: True from `go` on.
    order: the timed write.
    pending, switching: the expected replies to the starting and the switching command.
    started: interval of the start, when known.
    answered_ns: the latest instant at which its `OK` began to be sent.
    read_back_ns: when the controller has confirmed it right behind the move before; 0 for one that was loaded at rest.
    """

    lowered: ShrcLowered
    t0_ns: int
    output: DrivenOutput[ShrcOutput] | None = None
    released: bool = False
    order: TimedWrite | None = None
    pending: ShrcPending | None = None
    switching: ShrcPending | None = None
    started: HostInterval | None = None
    stopped_ns: int | None = None
    cancelled: bool = False
    answered_ns: int | None = None
    read_back_ns: int = 0
    seen: dict[int, AxisStatus] = field(default_factory=dict[int, AxisStatus])

    @property
    def start(self) -> HostInterval:
        """The interval of the start, known once `started` is set."""
        if self.started is None:
            raise RuntimeError("the move has not started")
        return self.started

    @property
    def motor_numbers(self) -> set[int]:
        return {move.motor for move in self.lowered.moves}

    @property
    def expected_replies(self) -> list[ShrcPending]:
        """Return the expected replies to the commands written at its start."""
        return [reply for reply in (self.pending, self.switching) if reply is not None]

    @property
    def waits_for_input(self) -> bool:
        """Whether an input starts it."""
        return self.lowered.wait is not None and bool(self.lowered.moves)

    @property
    def off_commands(self) -> list[str]:
        """The commands that make its output passive, from `go` on."""
        return [] if self.output is None or not self.released else [self.output.port.off_command]

    @property
    def start_commands(self) -> list[str]:
        """The commands that are written at its start; axes that wait for an input need none."""
        commands = [self.lowered.start] if self.lowered.moves and not self.waits_for_input else []
        return commands if self.output is None else [*commands, self.output.port.on_command]
