"""The current state of the fleet and its active jobs, gathered from the bus, as tables for a terminal."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from pydantic import ValidationError
from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.states.frame import Confirmation
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.operation.alarms import OPEN_BUS, AlarmRecord
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.report import FINISHED_STATES, JobProgress, LeaseState, QueueState
from orchestrator.model.state import AxisState, ControllerEvent, ControllerState
from orchestrator.model.steps.numbers import name_step
from orchestrator.monitor.open_bus import find_openness
from orchestrator.monitor.queue_words import describe_queue
from orchestrator.monitor.tables import make_plain_table
from orchestrator.monitor.times import format_time, localize_times
from orchestrator.monitor.virtual_view import make_virtual_table

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
STALE_S = 1.5  # adapters publish at least every 0.4 s
MAX_JOBS_SHOWN = 6


@dataclass(slots=True)
class LiveView:
    """The known state of the fleet; pass each arriving sample to `take_sample`. now_s: a monotonic clock, for ages.
    endpoint: of the bus."""

    keys: FleetKeys
    now_s: Callable[[], float]
    endpoint: str = ""
    states: dict[str, ControllerState] = field(default_factory=dict[str, ControllerState])
    received_s: dict[str, float] = field(default_factory=dict[str, float])
    """When the state of each controller was received, by `now_s`."""
    leases: dict[str, LeaseState] = field(default_factory=dict[str, LeaseState])
    """By holder."""
    queue: QueueState | None = None
    jobs: dict[str, JobProgress] = field(default_factory=dict[str, JobProgress])
    events: list[ControllerEvent] = field(default_factory=list[ControllerEvent])
    open_bus: dict[str, AlarmRecord] = field(default_factory=dict[str, AlarmRecord])
    """The alarms that other computers reach the bus without TLS, by id."""
    virtual: dict[str, VirtualState] = field(default_factory=dict[str, VirtualState])
    """Of virtual axes, by group."""

    @property
    def key_expressions(self) -> tuple[str, ...]:
        """The key expressions to subscribe to, beside what the controllers publish."""
        keys = self.keys
        return (keys.job_state(), keys.queue, keys.leases, keys.alarm(), keys.virtual())

    @property
    def openness(self) -> str:
        """What is to be said of a bus that other computers reach without TLS; "" where they do not."""
        return find_openness(self.endpoint, self.open_bus.values())

    def take_sample(self, sample: BusSample) -> str | None:
        """Store a sample. Return the line to print where there is no live screen; None if the sample needs none."""
        try:
            if sample.key.endswith("/event"):
                event = ControllerEvent.read_message(sample.payload)
                self.events = [*self.events, event][-MAX_EVENTS_SHOWN:]
                return f"{format_time(event.utc, precise=True)} {event.controller}: {_describe_event(event)}"
            if "/job/" in sample.key:
                progress = JobProgress.read_message(sample.payload)
                return format_job_line(progress) if self.store_progress(progress) else None
            if sample.key == self.keys.queue:
                return self._take_queue(QueueState.read_message(sample.payload))
            if "/lease/" in sample.key:
                self._take_lease(LeaseState.read_message(sample.payload))
                return None
            if "/virtual/" in sample.key:
                group = VirtualState.read_message(sample.payload)
                self.virtual[group.group] = group
                return None
            if "/alarm/" in sample.key:
                old_openness = self.openness
                self.take_alarms([AlarmRecord.read_message(sample.payload)])
                return self.openness if self.openness != old_openness else None
            state = ControllerState.read_message(sample.payload)
        except ValidationError:
            return f"unreadable message on {sample.key}"
        before_state, self.states[state.controller] = self.states.get(state.controller), state
        self.received_s[state.controller] = self.now_s()
        if before_state is not None and before_state.mode == state.mode:
            return None
        return f"{format_time(state.utc, precise=True)} {state.controller}: {state.mode}"

    def take_states(self, states: Mapping[str, ControllerState], leases: Iterable[LeaseState] = ()) -> None:
        """Store states and leases that were queried."""
        for lease in leases:
            self._take_lease(lease)
        for name, state in states.items():
            self.states[name] = state
            self.received_s[name] = self.now_s()

    def note_confirmed(self, confirmations: Mapping[str, Confirmation]) -> None:
        """Store how old the states are that hold still."""
        now_s = self.now_s()
        for name, confirmation in confirmations.items():
            self.received_s[name] = max(self.received_s.get(name, 0.0), now_s - confirmation.age_ns / NS_PER_S)

    def take_alarms(self, alarms: Iterable[AlarmRecord]) -> None:
        """Store which of these alarms say that the bus is open."""
        self.open_bus.update((alarm.id, alarm) for alarm in alarms if alarm.kind == OPEN_BUS)

    def find_ages(self) -> dict[str, float]:
        """The age of each controller's state, in s, where it is too old to be shown as live."""
        now_s = self.now_s()
        return {
            name: now_s - self.received_s.get(name, now_s)
            for name in self.states
            if now_s - self.received_s.get(name, now_s) > STALE_S
        }

    def _take_queue(self, queue: QueueState) -> str | None:
        state_before, self.queue = self.queue, queue
        was_stopped = state_before is not None and state_before.stopped is not None
        return describe_queue(queue) if (queue.stopped is not None) != was_stopped else None

    def _take_lease(self, lease: LeaseState) -> None:
        if lease.holder is not None:
            self.leases[lease.holder] = lease

    def store_progress(self, progress: JobProgress) -> bool:
        """Store a job's progress; return whether its state or step has changed. Of finished jobs only the newest is
        kept."""
        if not progress.follows(self.jobs.get(progress.job_id)):
            return False
        job_before = self.jobs.pop(progress.job_id, None)
        ends = progress.state in FINISHED_STATES
        kept_jobs = {job_id: job for job_id, job in self.jobs.items() if not (ends and job.state in FINISHED_STATES)}
        self.jobs = kept_jobs | {progress.job_id: progress}
        return job_before is None or (job_before.state, job_before.step) != (progress.state, progress.step)

    def render_screen(self) -> RenderableType:
        """Render the whole screen."""
        permits = name_missing_permits(self.queue)
        parts: list[RenderableType] = [Text(self.openness, "bold red")] if self.openness else []
        parts += [make_state_table(self.states, self.leases, self.find_ages(), permits)]
        parts += [make_virtual_table(self.virtual)] if self.virtual else []
        parts += self.render_jobs()
        if self.events:
            table = Table.grid(padding=(0, 2))
            for event in self.events:
                text = Text(event.text, overflow="ellipsis")
                table.add_row(format_time(event.utc), event.controller, event.kind, text)
            parts.append(table)
        return Group(*parts)

    def render_jobs(self) -> list[RenderableType]:
        """Render why no job begins, if so, and the active jobs."""
        parts: list[RenderableType] = []
        if self.queue is not None and self.queue.stopped is not None:
            parts.append(Text(describe_queue(self.queue), style="bold yellow"))
        shown_jobs = sorted(self.jobs.values(), key=lambda progress: (progress.state == "queued", progress.job_id))
        parts += [make_job_bar(job) for job in shown_jobs[:MAX_JOBS_SHOWN]]
        if len(shown_jobs) > MAX_JOBS_SHOWN:
            parts.append(Text(f"and {len(shown_jobs) - MAX_JOBS_SHOWN} more jobs; see `tutti job ls`", style="dim"))
        return parts


def make_state_table(
    states: Mapping[str, ControllerState],
    leases: Mapping[str, LeaseState] | None = None,
    ages: Mapping[str, float] | None = None,
    permits: Mapping[str, str] | None = None,
) -> RenderableType:
    """Build a table with one row per axis: its position, and the reason why it is not ready; then the faults of
    whole controllers.

    leases: by holder. ages: by controller, the age in s of a state that is too old to be shown as live. permits: by
    axis, the permits that are missing.
    """
    ages, permits = ages or {}, permits or {}
    table = make_plain_table(["controller", "mode", "axis", "position>", "velocity>", "clock>", "axis is"], ["axis is"])
    troubles: list[RenderableType] = []
    for controller, state in sorted(states.items()):
        age_s = ages.get(controller)
        is_known = state.mode != "offline"
        row_style = "" if age_s is None else "dim"
        mode = state.mode if age_s is None else f"unknown, {age_s:.0f} s old"
        for index, (axis, axis_now) in enumerate(state.axes.items()):
            first = index == 0
            table.add_row(
                controller if first else "",
                Text(mode, style="red" if age_s is not None else _MODE_STYLE.get(mode, "")) if first else "",
                axis,
                f"{axis_now.position:,.4f} {axis_now.unit}" if is_known else "-",
                f"{axis_now.velocity:,.2f} /s" if is_known else "-",
                _describe_clock(state) if first else "",
                _describe_ready(state, axis_now, permits.get(f"{controller}.{axis}"))
                if is_known and age_s is None
                else "",
                style=row_style,
            )
        troubles += _list_troubles(controller, state, leases or {}, age_s)
    return Group(table, *troubles)


def _list_troubles(
    controller: str, state: ControllerState, leases: Mapping[str, LeaseState], age_s: float | None
) -> list[Text]:
    """E-stop, manual control and faults of a controller; of a state that is too old to be shown as live, dimmed and
    with its age."""
    lines: list[tuple[str, str]] = []
    if state.estop is not None:
        reason = f": {state.estop.reason}" if state.estop.reason else ""
        lines.append((f"E-STOP by {state.estop.actor}{reason} → `tutti reset` when it is safe", "bold red"))
    held_leases = {holder for holder in state.leases.values() if holder.startswith("manual-")}
    lines += [(_describe_holder(holder, leases), "yellow") for holder in sorted(held_leases)]
    lines += [(f"{fault.text} → {fault.remedy}", "red") for fault in state.faults]
    if age_s is None:
        return [Text(f"{controller}: {line}", style) for line, style in lines]
    return [Text(f"{controller}, {age_s:.0f} s ago: {line}", "dim") for line, _ in lines]


def name_missing_permits(queue: QueueState | None) -> dict[str, str]:
    """The names of the permits that each axis misses."""
    missing_permits: dict[str, list[str]] = {}
    for permit in queue.missing_permits if queue is not None else ():
        for axis in permit.axes:
            missing_permits.setdefault(axis, []).append(permit.name)
    return {axis: ", ".join(names) for axis, names in missing_permits.items()}


def _describe_ready(state: ControllerState, axis: AxisState, permit: str | None) -> Text:
    """What keeps an axis from moving: its own state, an e-stop, a permit."""
    words = describe_axis(axis, estop=state.estop is not None)
    if permit is None:
        return words
    permit_text = Text(f"permit {permit}", style="yellow")
    return permit_text if words.plain == "ready" else Text(", ").join([words, permit_text])


def _describe_holder(holder: str, leases: Mapping[str, LeaseState]) -> str:
    lease = leases.get(holder)
    if lease is None:
        return "under manual control"
    return f"in use by {lease.actor} ({lease.what}{_describe_end(lease.until_utc)})"


def _describe_end(until_utc: str | None) -> str:
    return "" if until_utc is None else f", until {format_time(until_utc)}"


def describe_axis(axis: AxisState, *, estop: bool = False) -> Text:
    """Describe the state of an axis in few words: the reason why it is not ready, or that it is. estop: an e-stop is
    latched at its controller."""
    words: list[tuple[str, str]] = [("e-stop", "bold red")] if estop else []
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
    if axis.pair is not None:
        words = words or [("ready", "green")]
        words.append((f"motors {axis.pair.deviation:+.3g} {axis.unit} apart", ""))
    return Text(", ").join(Text(word, style=style) for word, style in words or [("ready", "green")])


def _describe_event(event: ControllerEvent) -> str:
    return event.text if event.text.startswith(event.kind) else f"{event.kind}: {event.text}"


def _describe_clock(state: ControllerState) -> str:
    return f"±{state.clock.bound_ns / 1e6:.2f} ms" if state.clock is not None else ""


def format_job_line(job: JobProgress) -> str:
    """Return a job's progress as one line."""
    return f"{format_time(job.utc, precise=True)} {describe_progress(job)}"


def describe_progress(job: JobProgress) -> str:
    """A job's progress in words, without its time."""
    reason = f" ({localize_times(job.reason)})" if job.reason else ""
    step = "" if job.state in FINISHED_STATES else f", {format_step(job)}"
    return f"job {job.name!r} {job.job_id}: {job.state}{step}{reason}"


def make_job_bar(job: JobProgress) -> RenderableType:
    """Render a job's progress: name and state, and below them a bar with the step."""
    head = Text.assemble(
        f"job {job.name!r} ",
        (job.job_id, "bold"),
        ": ",
        (job.state, _MODE_STYLE.get(job.state, "green" if job.state == "done" else "")),
    )
    if job.state in FINISHED_STATES or job.state == "queued":
        return Text.assemble(head, f" ({localize_times(job.reason)})" if job.reason else "")
    grid = Table.grid(padding=(0, 1))
    grid.add_column()
    grid.add_column(no_wrap=True)
    time_text = f", {job.remaining_s:.1f} s left" if job.remaining_s is not None else ""
    grid.add_row(
        ProgressBar(total=1.0, completed=job.fraction, width=24),
        f"{format_step(job)}{format_line(job)}{time_text}",
    )
    return Group(head, grid)


def format_line(job: JobProgress) -> str:
    """The line that runs of the file of its path: `, line 12`. It changes too often for lines that stay."""
    return "" if job.line is None else f", line {job.line}"


def format_step(job: JobProgress) -> str:
    """Number the step as reasons and reports do, and as `--step` and `--from-point` expect it."""
    if job.scan_step is not None:
        return f"{f'{name_step(job.scan_step)} {job.step_name}'.rstrip()}, point {job.point} of {job.points}"
    return f"{name_step(job.step)} of {job.steps} {job.step_name}".rstrip()
