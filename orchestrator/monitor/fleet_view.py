"""The current state of the fleet and its active jobs, gathered from the bus, as tables for a terminal."""

from dataclasses import dataclass, field

from pydantic import ValidationError
from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.model.report import FINISHED_STATES, JobProgress
from orchestrator.model.state import AxisState, ControllerEvent, ControllerState
from orchestrator.monitor.tables import make_plain_table

_MODE_STYLE = {
    "idle": "green",
    "armed": "yellow",
    "committed": "yellow",
    "moving": "cyan",
    "jogging": "cyan",
    "homing": "cyan",
    "stopping": "yellow",
    "offline": "red",
    "fault": "red",
}
MAX_EVENTS_SHOWN = 5
MAX_JOBS_SHOWN = 6


@dataclass(slots=True)
class LiveView:
    """The known state of the fleet; pass each arriving sample to `take_sample`."""

    keys: FleetKeys
    states: dict[str, ControllerState] = field(default_factory=dict[str, ControllerState])
    jobs: dict[str, JobProgress] = field(default_factory=dict[str, JobProgress])
    events: list[ControllerEvent] = field(default_factory=list[ControllerEvent])

    @property
    def key_expressions(self) -> tuple[str, ...]:
        """The key expressions to subscribe to."""
        return (self.keys.state(), self.keys.event(), self.keys.job_state())

    def take_sample(self, sample: BusSample) -> str | None:
        """Store a sample. Return the line to print where there is no live screen; None if the sample needs none."""
        try:
            if sample.key.endswith("/event"):
                event = ControllerEvent.model_validate_json(sample.payload)
                self.events = [*self.events, event][-MAX_EVENTS_SHOWN:]
                return f"{event.utc} {event.controller}: {event.kind}: {event.text}"
            if "/job/" in sample.key:
                progress = JobProgress.model_validate_json(sample.payload)
                return format_job_line(progress) if self.store_progress(progress) else None
            state = ControllerState.model_validate_json(sample.payload)
        except ValidationError:
            return f"unreadable message on {sample.key}"
        before_state, self.states[state.controller] = self.states.get(state.controller), state
        if before_state is not None and before_state.mode == state.mode:
            return None
        return f"{state.utc} {state.controller}: {state.mode}"

    def store_progress(self, progress: JobProgress) -> bool:
        """Store a job's progress; return whether its state or step has changed. Of finished jobs only the newest is
        kept."""
        before = self.jobs.pop(progress.job_id, None)
        ends = progress.state in FINISHED_STATES
        kept = {job_id: each for job_id, each in self.jobs.items() if not (ends and each.state in FINISHED_STATES)}
        self.jobs = kept | {progress.job_id: progress}
        return before is None or (before.state, before.step) != (progress.state, progress.step)

    def render_screen(self) -> RenderableType:
        """Render the whole screen."""
        parts: list[RenderableType] = [make_state_table(self.states)]
        shown = sorted(self.jobs.values(), key=lambda each: (each.state == "queued", each.job_id))
        parts += [make_job_bar(each) for each in shown[:MAX_JOBS_SHOWN]]
        if len(shown) > MAX_JOBS_SHOWN:
            parts.append(Text(f"and {len(shown) - MAX_JOBS_SHOWN} more jobs; see `tutti job ls`", style="dim"))
        if self.events:
            table = Table.grid(padding=(0, 2))
            for event in self.events:
                table.add_row(event.utc[11:19], event.controller, event.kind, Text(event.text, overflow="ellipsis"))
            parts.append(table)
        return Group(*parts)


def make_state_table(states: dict[str, ControllerState]) -> RenderableType:
    """Build a table with one row per axis: its position, and the reason why it is not ready; then the faults of
    whole controllers."""
    table = make_plain_table(["controller", "mode", "axis", "position>", "velocity>", "clock>", "axis is"])
    troubles: list[RenderableType] = []
    for controller, state in sorted(states.items()):
        known = state.mode != "offline"
        for index, (axis, now) in enumerate(state.axes.items()):
            first = index == 0
            table.add_row(
                controller if first else "",
                Text(state.mode, style=_MODE_STYLE.get(state.mode, "")) if first else "",
                axis,
                f"{now.position:,.4f} {now.unit}" if known else "-",
                f"{now.velocity:,.2f} /s" if known else "-",
                _describe_clock(state) if first else "",
                describe_axis(now) if known else "",
            )
        if state.estop is not None:
            why = f": {state.estop.reason}" if state.estop.reason else ""
            by = f"{controller}: E-STOP by {state.estop.actor}{why} → `tutti reset` when it is safe"
            troubles.append(Text(by, style="bold red"))
        held = {holder for holder in state.leases.values() if holder.startswith("manual-")}
        troubles += [Text(f"{controller}: under manual control ({holder})", style="yellow") for holder in sorted(held)]
        troubles += [Text(f"{controller}: {fault.text} → {fault.remedy}", style="red") for fault in state.faults]
    return Group(table, *troubles)


def describe_axis(axis: AxisState) -> Text:
    """Describe the state of an axis in few words: the reason why it is not ready, or that it is."""
    words: list[tuple[str, str]] = []
    if axis.homing:
        words.append(("homing", "cyan"))
    elif axis.moving:
        words.append(("moving", "cyan"))
    if not axis.enabled:
        words.append(("off", "yellow"))
    if not axis.referenced:
        words.append(("unreferenced", "yellow"))
    if axis.limit != "none":
        words.append((f"on {axis.limit} limit", "red"))
    return Text(", ").join(Text(word, style=style) for word, style in words or [("ready", "green")])


def _describe_clock(state: ControllerState) -> str:
    return f"±{state.clock.bound_ns / 1e6:.2f} ms" if state.clock is not None else ""


def format_job_line(job: JobProgress) -> str:
    """Return a job's progress as one line."""
    reason = f" ({job.reason})" if job.reason else ""
    if job.state in FINISHED_STATES:
        return f"{job.utc} job {job.job_id} {job.name!r}: {job.state}{reason}"
    return f"{job.utc} job {job.job_id} {job.name!r}: {job.state}, {_format_step(job)}{reason}"


def make_job_bar(job: JobProgress) -> RenderableType:
    """Render a job's progress: name and state, and below them a bar with the step."""
    head = Text.assemble(
        "job ",
        (job.job_id, "bold"),
        f" {job.name!r}: ",
        (job.state, _MODE_STYLE.get(job.state, "green" if job.state == "done" else "")),
    )
    if job.state in FINISHED_STATES:
        return Text.assemble(head, f" ({job.reason})" if job.reason else "")
    grid = Table.grid(padding=(0, 1))
    grid.add_column()
    grid.add_column(no_wrap=True)
    left = f", {job.remaining_s:.1f} s left" if job.remaining_s is not None else ""
    grid.add_row(
        ProgressBar(total=1.0, completed=job.fraction, width=24),
        f"{_format_step(job)}{left}",
    )
    return Group(head, grid)


def _format_step(job: JobProgress) -> str:
    """Number the step as reasons and reports do, and as `--from-step` expects it."""
    return f"step {job.step} {job.step_name}, {job.step + 1} of {job.steps}"
