"""The state of the fleet as one JSON object, gathered from the bus. It never contains null (see `merge_patch`)."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.gateway.stream.controllers import find_age_s, show_controller
from orchestrator.gateway.stream.merge_patch import drop_nulls
from orchestrator.gateway.stream.targets import JobTargets
from orchestrator.gateway.stream.virtual_groups import VirtualGroups
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.names import split_name
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.operation.recording import JobBegun
from orchestrator.model.report import FINISHED_STATES, JobProgress, LeaseState, QueueState
from orchestrator.model.state import ControllerEvent, ControllerState, LinkTotals
from orchestrator.model.web_views import WebView

MAX_EVENTS = 100
MAX_CONTROLLERS, MAX_JOBS, MAX_ALARMS, MAX_LEASES = 500, 300, 1000, 2000  # whatever is published
KEEP_ENDED_NS = 60 * NS_PER_S  # of a job that has ended
LEADER_NS = NS_PER_S  # ten heartbeats are missing

_Take = Callable[[BusSample], None]


def list_views(fleet: Fleet | None) -> Sequence[WebView]:
    """The cameras of the machine; none while the fleet file is not known."""
    return () if fleet is None else fleet.web.views


def allows_open_stop(fleet: Fleet | None) -> bool:
    """Whether a stop needs no user; not while the fleet file is not known."""
    return fleet is not None and fleet.web.stop_without_signing_in


def show_views(fleet: Fleet | None) -> dict[str, Any]:
    """The cameras as a part of the state; without any no part."""
    views = [view.to_plain() for view in list_views(fleet)]
    return {"views": views} if views else {}


def show_leader(leader: tuple[int, LeaderHeartbeat] | None, now_ns: int) -> dict[str, Any]:
    """The coordinator that leads. leader: its last heartbeat, and when that was received."""
    if leader is None or now_ns - leader[0] > LEADER_NS:
        return {"present": False}
    heartbeat = leader[1]
    return {"present": True, "name": heartbeat.coordinator[:8], "epoch": heartbeat.epoch}


class FleetState:
    """Pass each sample to `take_sample`; `compose` returns the state.

    Values are kept as they arrive and made ready when they are asked for: at most 20 times a second, however often they
    are published.
    """

    def __init__(self, keys: FleetKeys, clock: Clock) -> None:
        self.fleet: Fleet | None = None
        self.on_unknown_digest: Callable[[], None] = lambda: None
        self.invalid = 0
        self._keys, self._clock = keys, clock
        self._states: dict[str, ControllerState] = {}
        self._received_ns: dict[str, int] = {}
        self._raw: dict[str, bytes] = {}
        self._rests: dict[str, dict[str, float]] = {}
        self._shown: dict[str, dict[str, Any]] = {}
        self._present: dict[str, int] = {}
        self._links: dict[str, dict[str, Any]] = {}
        self._leases: dict[str, dict[str, Any]] = {}
        self._alarms: dict[str, dict[str, Any]] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=MAX_EVENTS)
        self._event_number = 0
        self._queue: QueueState | None = None
        self._jobs: dict[str, JobProgress] = {}
        self._ended_ns: dict[str, int] = {}
        self._targets = JobTargets()
        self._virtual = VirtualGroups()
        self._leader: tuple[int, LeaderHeartbeat] | None = None
        self._last_stop: dict[str, Any] | None = None
        self._takers: dict[str, _Take] = {
            "state": self._take_state,
            "event": self._take_event,
            "link": self._take_link,
        }

    @property
    def key_expressions(self) -> tuple[str, ...]:
        """The key expressions to subscribe to."""
        keys = self._keys
        jobs = (keys.job_state(), keys.job_begun())
        states = (keys.state(), keys.event(), keys.link(), keys.virtual())
        return (*states, *jobs, keys.queue, keys.leases, keys.alarm(), keys.leader)

    @property
    def controllers(self) -> list[str]:
        """The controllers that have published a state."""
        return list(self._received_ns)

    def find_rest(self, axis: str) -> float | None:
        """The commanded user position of `controller.axis` when it was at rest last; None if it is not known."""
        controller, name = split_name(axis)
        self._read_state(controller)
        return self._rests.get(controller, {}).get(name, self._virtual.find_rest(controller, name))

    # What arrives

    def take_sample(self, sample: BusSample) -> None:
        """Store a sample; one that is not valid is counted."""
        try:
            chunks = sample.key.removeprefix(f"{self._keys.prefix}/").split("/")
            kind, leaf = chunks[0], chunks[-1]
            if kind == "ctl":
                self._takers[leaf](sample)
            elif kind == "job":
                self._take_job(sample, leaf)
            elif kind == "virtual":
                self._virtual.take_payload(chunks[1], sample.payload, self._clock.now_ns())
            elif kind == "lease":
                self._take_lease(LeaseState.read_message(sample.payload))
            elif kind == "alarm":
                self.take_alarm(AlarmRecord.read_message(sample.payload))
            elif kind == "queue":
                self._queue = QueueState.read_message(sample.payload)
            elif kind == "leader":
                self._leader = self._clock.now_ns(), LeaderHeartbeat.read_message(sample.payload)
        except (ValidationError, KeyError):
            self.invalid += 1

    def take_states(self, states: Mapping[str, ControllerState]) -> None:
        """Store states that were queried."""
        for name, state in states.items():
            self._keep_state(name)
            self._note_state(name, state)

    def take_presence(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback of the bus
        """Store that an adapter has come, or gone."""
        controller = key.split("/")[-2]
        self._present[controller] = max(0, self._present.get(controller, 0) + (1 if present else -1))
        self._shown.pop(controller, None)

    def take_alarm(self, alarm: AlarmRecord) -> None:
        """Store an alarm."""
        if alarm.state == "normal":
            self._alarms.pop(alarm.id, None)
        elif len(self._alarms) < MAX_ALARMS or alarm.id in self._alarms:
            self._alarms[alarm.id] = drop_nulls(alarm.to_plain())

    def take_alarms(self, alarms: Iterable[AlarmRecord]) -> None:
        """Store all alarms that are not normal."""
        self._alarms.clear()
        for alarm in alarms:
            self.take_alarm(alarm)

    @property
    def has_queue(self) -> bool:
        """Whether the queue is known."""
        return self._queue is not None

    def take_queue(self, queue: QueueState) -> None:
        """Store the queue that was queried."""
        self._queue = queue

    def take_stop(self, what: str, actor: str) -> dict[str, Any]:
        """Store which stop was requested last, and by which actor; return it for the stream."""
        self._last_stop = {"by": actor, "what": what, "utc": self._clock.utc()}
        return self._last_stop

    def take_fleet(self, fleet: Fleet) -> None:
        """Store the configuration of the fleet."""
        self.fleet = fleet
        self._shown.clear()
        for name in self._received_ns.keys() - fleet.controllers.keys():
            del self._received_ns[name]

    def _take_state(self, sample: BusSample) -> None:
        controller = sample.key.split("/")[-2]
        if self.fleet is not None and controller not in self.fleet.controllers:
            self.on_unknown_digest()  # a new file may have it; until then nothing of it is shown
            raise KeyError(controller)
        if len(self._received_ns) >= MAX_CONTROLLERS and controller not in self._received_ns:
            raise KeyError(controller)
        self._keep_state(controller)
        self._raw[controller] = sample.payload

    def _keep_state(self, controller: str) -> None:
        self._received_ns[controller] = self._clock.now_ns()
        self._shown.pop(controller, None)

    def _take_event(self, sample: BusSample) -> None:
        event = ControllerEvent.read_message(sample.payload)
        self._event_number += 1
        entry = {"n": self._event_number, "controller": event.controller, "kind": event.kind, "text": event.text}
        self._events.append(drop_nulls(entry | {"utc": event.utc, "job": event.job, "step": event.step}))

    def _take_link(self, sample: BusSample) -> None:
        totals = LinkTotals.read_message(sample.payload)
        self._links[totals.controller] = {"bytes_out": totals.bytes_out, "bytes_in": totals.bytes_in}
        self._shown.pop(totals.controller, None)

    def _take_job(self, sample: BusSample, leaf: str) -> None:
        if leaf == "begun":
            self._targets.take_job(JobBegun.read_message(sample.payload))
            return
        progress = JobProgress.read_message(sample.payload)
        if not progress.follows(self._jobs.get(progress.job_id)):
            return
        if progress.state in FINISHED_STATES:
            self._ended_ns[progress.job_id] = self._clock.now_ns()
        self._jobs[progress.job_id] = progress
        if len(self._jobs) > MAX_JOBS:
            oldest = next(iter(self._jobs))
            del self._jobs[oldest]
            self._ended_ns.pop(oldest, None)
        if self._targets.take_progress(progress, self.fleet, self.find_rest):
            self._shown.clear()

    def _take_lease(self, lease: LeaseState) -> None:
        name = lease.controller if lease.axis is None else f"{lease.controller}.{lease.axis}"
        if lease.holder is None:
            self._leases.pop(name, None)
        elif len(self._leases) < MAX_LEASES or name in self._leases:
            entry = {"holder": lease.holder, "actor": lease.actor, "what": lease.what, "until_utc": lease.until_utc}
            self._leases[name] = drop_nulls(entry)

    # What is shown

    def compose(self) -> dict[str, Any]:
        """The state now, for the stream."""
        now_ns = self._clock.now_ns()
        for job_id in [ended_id for ended_id, ended_ns in self._ended_ns.items() if now_ns - ended_ns > KEEP_ENDED_NS]:
            del self._ended_ns[job_id]
            self._jobs.pop(job_id, None)
        state: dict[str, Any] = {
            "fleet": self._keys.fleet,
            "utc": f"{self._clock.utc()[:19]}Z",
            "coordinator": show_leader(self._leader, now_ns),
            "controllers": {name: self._show_controller(name, now_ns) for name in sorted(self._received_ns)},
            "leases": dict(self._leases),
            "jobs": {job_id: drop_nulls(job.to_plain()) for job_id, job in self._jobs.items()},
            "members": self._find_members(),
            "paths": dict(self._targets.paths),
            "alarms": dict(self._alarms),
            "events": list(self._events),
        }
        if self._queue is not None:
            plain = self._queue.to_plain()
            state["permits"] = plain.pop("missing_permits")
            state["queue"] = drop_nulls(plain)
        state |= show_views(self.fleet) | self._virtual.compose(self.fleet, self._targets.by_axis, now_ns)
        if self._last_stop is not None:
            state["last_stop"] = self._last_stop
        return state

    def _show_controller(self, name: str, now_ns: int) -> dict[str, Any]:
        shown_controller = self._shown.get(name)
        if shown_controller is None:
            shown_controller = self._shown[name] = self._make_controller(name)
        age_s = find_age_s(now_ns - self._received_ns[name])
        return shown_controller if shown_controller.get("age_s") == age_s else {**shown_controller, "age_s": age_s}

    def _make_controller(self, name: str) -> dict[str, Any]:
        present = {"present": self._present.get(name, 0) > 0, "age_s": 0}
        state = self._read_state(name)
        if state is None:
            return {**present, "mode": "unknown", "axes": {}}
        config = None if self.fleet is None else self.fleet.controllers.get(name)
        if self.fleet is None or (config is not None and config.digest != state.digest):
            self.on_unknown_digest()
        head = f"{name}."
        targets = {
            axis.removeprefix(head): target for axis, target in self._targets.by_axis.items() if axis.startswith(head)
        }
        shown_controller = show_controller(state, config, targets) | present
        return shown_controller | {"link": self._links[name]} if name in self._links else shown_controller

    def _read_state(self, name: str) -> ControllerState | None:
        """The newest state; it is parsed only now. None if it is not valid and there was none before."""
        raw = self._raw.pop(name, None)
        if raw is not None:
            try:
                self._note_state(name, ControllerState.read_message(raw))
            except ValidationError:
                self.invalid += 1
        return self._states.get(name)

    def _note_state(self, name: str, state: ControllerState) -> None:
        self._states[name] = state
        rests = self._rests.setdefault(name, {})
        rests |= {axis: axis_now.commanded for axis, axis_now in state.axes.items() if not axis_now.moving}

    def _find_members(self) -> dict[str, Any]:
        """The stage of each member of the step that a job runs."""
        members: dict[str, Any] = {}
        for name in self._received_ns:
            state = self._states.get(name)
            if state is not None and state.job is not None and state.job in self._jobs:
                job = members.setdefault(state.job, {"step": state.step or 0, "members": {}})
                job["members"][name] = state.mode
        return members
