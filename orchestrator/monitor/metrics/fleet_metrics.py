"""The metrics of one fleet, counted from what it publishes.

No metric has the id of a job as a label, and none is a position: their number stays that of the controllers.
"""

from collections import Counter as CountedValues
from collections.abc import Callable, Iterable, Iterator

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.executor import ThreadLock
from orchestrator.model.base import Model
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.report import FINISHED_STATES, JobReport, QueueState, StepReport
from orchestrator.model.state import ClockMapping, ControllerEvent, ControllerState, LinkTotals

# Bounds of histograms: from the microseconds of a trigger line to the seconds of a slow serial line.
_SKEW_S = (1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.5)
_STAGE_S = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
_RATIO = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
FORGET_NS = 3600 * NS_PER_S  # a controller that has published nothing for so long is no longer shown


class FleetMetrics(Collector):
    """Takes messages, and gives the values to a registry. Both may be in threads of their own."""

    def __init__(self, clock: Clock, counts: Callable[[], tuple[int, int, int]]) -> None:
        """counts: messages that the recorder has written, left out, and found not valid."""
        self.registry = CollectorRegistry(auto_describe=True)
        self._clock, self._counts = clock, counts
        self._lock = ThreadLock()
        self._states: dict[str, tuple[int, ControllerState]] = {}
        self._mappings: dict[str, ClockMapping] = {}
        self._links: dict[str, LinkTotals] = {}
        self._alarms: dict[str, AlarmRecord] = {}
        self._virtual: dict[str, VirtualState] = {}
        self._queue: QueueState | None = None
        self._leader: tuple[int, LeaderHeartbeat] | None = None
        make = self.registry
        self._skews = Histogram(
            "tutti_start_skew_seconds",
            "Start skew of motion steps, by evidence: its upper bound.",
            registry=make,
            buckets=_SKEW_S,
        )
        self._budgets = Histogram(
            "tutti_budget_used_ratio",
            "Predicted start skew of motion steps as a share of the allowed one.",
            registry=make,
            buckets=_RATIO,
        )
        self._stages = Histogram(
            "tutti_stage_seconds", "Duration of the stages of motion steps.", ["stage"], registry=make, buckets=_STAGE_S
        )
        self._steps = Counter("tutti_steps", "Motion steps by verdict.", ["verdict"], registry=make)
        self._jobs = Counter("tutti_jobs", "Jobs that have ended, by state.", ["state"], registry=make)
        self._refusals = Counter("tutti_refusals", "Refused steps, by code.", ["code"], registry=make)
        self._faults = Counter("tutti_faults", "Faults of controllers, by code.", ["controller", "code"], registry=make)
        self._events = Counter("tutti_events", "Events of controllers, by kind.", ["controller", "kind"], registry=make)
        self._losses = Counter("tutti_link_losses", "Links that were lost.", ["controller"], registry=make)
        self.registry.register(self)

    def take_message(self, message: Model) -> None:
        """Count a message."""
        now_ns = self._clock.now_ns()
        with self._lock:
            if isinstance(message, ControllerState):
                self._states[message.controller] = now_ns, message
            elif isinstance(message, ClockMapping):
                self._mappings[message.controller] = message
            elif isinstance(message, LinkTotals):
                self._links[message.controller] = message
            elif isinstance(message, VirtualState):
                self._virtual[message.group] = message
            elif isinstance(message, AlarmRecord):
                self._alarms[message.id] = message
            elif isinstance(message, QueueState):
                self._queue = message
            elif isinstance(message, LeaderHeartbeat):
                self._leader = now_ns, message
        if isinstance(message, ControllerEvent):
            self._events.labels(message.controller, message.kind).inc()
            if message.kind == "offline":
                self._losses.labels(message.controller).inc()
            if message.kind == "fault" and message.fault is not None:
                self._faults.labels(message.controller, message.fault.code).inc()
        elif isinstance(message, JobReport):
            self._count_job(message)

    def collect(self) -> Iterator[GaugeMetricFamily | CounterMetricFamily]:
        """The values that are gauges now."""
        now_ns = self._clock.now_ns()
        with self._lock:
            self._states = {name: state for name, state in self._states.items() if now_ns - state[0] < FORGET_NS}
            states, mappings, links = dict(self._states), dict(self._mappings), dict(self._links)
            queue, leader, alarms = self._queue, self._leader, list(self._alarms.values())
            virtual = list(self._virtual.values())
        yield from _collect_controllers(now_ns, states)
        yield from _collect_clocks(mappings)
        yield _collect_links(links)
        yield _collect_alarms(alarms)
        yield _collect_virtual(virtual)
        yield from _collect_fleet(now_ns, queue, leader)
        written_count, dropped_count, invalid = self._counts()
        yield CounterMetricFamily("tutti_recorder_messages", "Messages that were recorded.", value=written_count)
        yield CounterMetricFamily(
            "tutti_recorder_dropped_messages", "Messages that were left out.", value=dropped_count
        )
        yield CounterMetricFamily("tutti_recorder_invalid_messages", "Messages that were not valid.", value=invalid)

    def _count_job(self, report: JobReport) -> None:
        if report.state in FINISHED_STATES:
            self._jobs.labels(report.state).inc()
        for step in report.steps:
            if step.scan is not None:
                for verdict, count in step.scan.verdicts.items():
                    self._steps.labels(verdict).inc(count)
            if step.refused is not None:
                self._refusals.labels(step.refused.code).inc()
            if step.members:
                self._count_step(step)

    def _count_step(self, step: StepReport) -> None:
        self._steps.labels(step.verdict).inc()
        if step.narrowest_skew is not None:
            self._skews.observe(step.narrowest_skew.at_most_ns / NS_PER_S)
        if step.budget is not None and step.budget.allowed_ns:
            self._budgets.observe(step.budget.predicted_ns / step.budget.allowed_ns)
        for member in step.members.values():
            self._stages.labels("arm").observe(member.armed_in_ns / NS_PER_S)
            for stage, duration_ns in member.stages_ns.items():
                self._stages.labels(f"arm-{stage}").observe(duration_ns / NS_PER_S)
        begun_ns, settled_ns, t0_ns = step.arming_fleet_ns, step.settled_fleet_ns, step.t0_fleet_ns
        if begun_ns is not None and settled_ns is not None and t0_ns is not None:
            self._stages.labels("promise").observe(max(0, settled_ns - begun_ns) / NS_PER_S)
            self._stages.labels("wait").observe(max(0, t0_ns - settled_ns) / NS_PER_S)


def _gauge(name: str, text: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, text, value=value)


def _collect_controllers(now_ns: int, states: dict[str, tuple[int, ControllerState]]) -> Iterator[GaugeMetricFamily]:
    age = GaugeMetricFamily("tutti_controller_state_age_seconds", "Age of the last state.", labels=["controller"])
    online = GaugeMetricFamily("tutti_controller_online", "1: its link is open.", labels=["controller"])
    latched_family = GaugeMetricFamily("tutti_estop_latched", "1: an e-stop is latched.", labels=["controller"])
    faults = GaugeMetricFamily("tutti_controller_faults", "Faults that stand.", labels=["controller"])
    bound = GaugeMetricFamily(
        "tutti_clock_bound_seconds", "Guaranteed error of the clock's estimate.", labels=["controller"]
    )
    for name, (received_ns, state) in states.items():
        age.add_metric([name], (now_ns - received_ns) / NS_PER_S)
        online.add_metric([name], state.mode != "offline")
        latched_family.add_metric([name], state.estop is not None)
        faults.add_metric([name], len(state.faults))
        if state.clock is not None:
            bound.add_metric([name], state.clock.bound_ns / NS_PER_S)
    yield from (age, online, latched_family, faults, bound)


def _collect_clocks(mappings: dict[str, ClockMapping]) -> Iterator[GaugeMetricFamily]:
    rate = GaugeMetricFamily(
        "tutti_clock_rate_ppm", "How much longer the controller's tick is than nominal.", labels=["controller"]
    )
    for name, mapping in mappings.items():
        rate.add_metric([name], mapping.rate_ppm)
    yield rate


def _collect_links(links: dict[str, LinkTotals]) -> CounterMetricFamily:
    family = CounterMetricFamily("tutti_link_bytes", "Bytes on the link.", labels=["controller", "direction"])
    for name, totals in links.items():
        family.add_metric([name, "out"], totals.bytes_out)
        family.add_metric([name, "in"], totals.bytes_in)
    return family


def _collect_alarms(alarms: Iterable[AlarmRecord]) -> GaugeMetricFamily:
    family = GaugeMetricFamily("tutti_alarms", "Alarms that are not normal, by priority.", labels=["priority", "state"])
    open_alarms = [alarm for alarm in alarms if alarm.state != "normal"]
    alarm_counts = CountedValues((alarm.priority, alarm.state) for alarm in open_alarms)
    for (priority, state), count in alarm_counts.items():
        family.add_metric([priority, state], count)
    return family


def _collect_virtual(groups: Iterable[VirtualState]) -> GaugeMetricFamily:
    family = GaugeMetricFamily("tutti_virtual_ready", "1: its virtual axes can be moved.", labels=["group"])
    for group in groups:
        family.add_metric([group.group], not group.obstacle)
    return family


def _collect_fleet(
    now_ns: int, queue: QueueState | None, leader: tuple[int, LeaderHeartbeat] | None
) -> Iterator[GaugeMetricFamily]:
    if queue is not None:
        yield _gauge("tutti_queue_length", "Jobs that wait.", queue.waiting)
        yield _gauge("tutti_queue_stopped", "1: no job of the queue begins.", queue.stopped is not None)
    if leader is not None:
        received_ns, heartbeat = leader
        yield _gauge(
            "tutti_leader_age_seconds", "Age of the leader's last heartbeat.", (now_ns - received_ns) / NS_PER_S
        )
        yield _gauge("tutti_leader_epoch", "Epoch of the leader; it grows with each change.", heartbeat.epoch)
