"""The fleet and the running job as they are now, gathered from the bus, and as tables for a terminal."""

from dataclasses import dataclass, field

from pydantic import ValidationError
from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from orchestrator.bus.base import Sample
from orchestrator.bus.keys import Keys
from orchestrator.model.report import ENDED, Progress
from orchestrator.model.state import AxisState, ControllerState, Event

_MODE_STYLE = {
    "idle": "green",
    "armed": "yellow",
    "committed": "yellow",
    "moving": "cyan",
    "homing": "cyan",
    "stopping": "yellow",
    "offline": "red",
    "fault": "red",
}
EVENTS_SHOWN = 5


@dataclass(slots=True)
class LiveView:
    """What is known of the fleet; `take` it samples as they come."""

    keys: Keys
    states: dict[str, ControllerState] = field(default_factory=dict[str, ControllerState])
    job: Progress | None = None
    events: list[Event] = field(default_factory=list[Event])

    @property
    def expressions(self) -> tuple[str, ...]:
        """What to subscribe to."""
        return (self.keys.state(), self.keys.event(), self.keys.job_state())

    def take(self, sample: Sample) -> str | None:
        """Take a sample in. The line to print where there is no live screen; None if it is not worth one."""
        try:
            if sample.key.endswith("/event"):
                event = Event.model_validate_json(sample.payload)
                self.events = [*self.events, event][-EVENTS_SHOWN:]
                return f"{event.utc} {event.controller}: {event.kind}: {event.text}"
            if "/job/" in sample.key:
                before, self.job = self.job, Progress.model_validate_json(sample.payload)
                same = before is not None and (before.state, before.step) == (self.job.state, self.job.step)
                return None if same else job_line(self.job)
            state = ControllerState.model_validate_json(sample.payload)
        except ValidationError:
            return f"something that can not be read on {sample.key}"
        before_state, self.states[state.controller] = self.states.get(state.controller), state
        if before_state is not None and before_state.mode == state.mode:
            return None
        return f"{state.utc} {state.controller}: {state.mode}"

    def render(self) -> RenderableType:
        """The whole screen."""
        parts: list[RenderableType] = [state_table(self.states)]
        if self.job is not None:
            parts.append(job_bar(self.job))
        if self.events:
            table = Table.grid(padding=(0, 2))
            for event in self.events:
                table.add_row(event.utc[11:19], event.controller, event.kind, Text(event.text, overflow="ellipsis"))
            parts.append(table)
        return Group(*parts)


def state_table(states: dict[str, ControllerState]) -> Table:
    """One row an axis: where it is, and what keeps it from moving."""
    table = Table(expand=False, header_style="bold")
    for name in ("controller", "mode", "axis"):
        table.add_column(name)
    table.add_column("position", justify="right", min_width=14)
    table.add_column("velocity", justify="right", min_width=12)
    table.add_column("axis state")
    table.add_column("clock", justify="right")
    for controller, state in sorted(states.items()):
        first = True
        for axis, now in state.axes.items():
            mode = Text(state.mode, style=_MODE_STYLE.get(state.mode, "")) if first else Text("")
            table.add_row(
                controller if first else "",
                mode,
                axis,
                f"{now.position:,.4f} {now.unit}" if state.mode != "offline" else "-",
                f"{now.velocity:,.3f} /s" if state.mode != "offline" else "-",
                axis_words(now, state) if state.mode != "offline" else Text(""),
                _clock_words(state) if first else "",
            )
            first = False
        if state.estop is not None:
            table.add_row("", Text("E-STOP", style="bold red"), "", "", "", Text(f"by {state.estop.actor}"), "")
        for fault in state.faults:
            table.add_row("", "", "", "", "", Text(f"{fault.text} → {fault.remedy}", style="red"), "")
        table.add_section()
    return table


def axis_words(axis: AxisState, state: ControllerState) -> Text:
    """What an axis is, in few words."""
    words = Text()
    if axis.moving:
        words.append("moving ", style="cyan")
    words.append("enabled " if axis.enabled else "off ", style="" if axis.enabled else "yellow")
    words.append("referenced" if axis.referenced else "not referenced", style="" if axis.referenced else "yellow")
    if axis.limit != "none":
        words.append(f" on {axis.limit} limit", style="red")
    return words


def _clock_words(state: ControllerState) -> str:
    return f"±{state.clock.bound_ns / 1e6:.2f} ms" if state.clock is not None else ""


def job_line(job: Progress) -> str:
    """A job's progress as one line."""
    reason = f" ({job.reason})" if job.reason else ""
    if job.state in ENDED:
        return f"{job.utc} job {job.job_id} {job.name!r}: {job.state}{reason}"
    return (
        f"{job.utc} job {job.job_id} {job.name!r}: {job.state}, step {job.step + 1}/{job.steps} {job.step_name}{reason}"
    )


def job_bar(job: Progress) -> RenderableType:
    """A job's progress as a bar."""
    grid = Table.grid(padding=(0, 1))
    remaining = f"{job.remaining_s:.1f} s left in the step" if job.remaining_s is not None else ""
    grid.add_row(
        Text(f"job {job.job_id}", style="bold"),
        job.name,
        Text(job.state, style=_MODE_STYLE.get(job.state, "green" if job.state == "done" else "")),
        ProgressBar(total=1.0, completed=job.fraction, width=30),
        f"step {job.step + 1}/{job.steps} {job.step_name}" if job.state not in ENDED else job.reason,
        remaining,
    )
    return grid
