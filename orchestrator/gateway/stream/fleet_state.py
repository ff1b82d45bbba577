"""The state of the fleet as one JSON object, gathered from the bus. It never contains null (see `merge_patch`)."""

from collections.abc import Callable, Iterable, Mapping
from itertools import islice
from typing import Any

from pydantic import ValidationError

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.states.feed import Arrival
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.gateway.stream.clock_history import ClockHistory
from orchestrator.gateway.stream.controllers import STALE_NS, find_age_s, show_controller
from orchestrator.gateway.stream.counts import FleetCounts
from orchestrator.gateway.stream.fleet_parts import show_leader, show_views
from orchestrator.gateway.stream.job_table import JobTable
from orchestrator.gateway.stream.leases import LeaseTable
from orchestrator.gateway.stream.messages import FleetMessages
from orchestrator.gateway.stream.need import EVERYTHING, ChosenNames, StreamNeed
from orchestrator.gateway.stream.presence import AdapterPresence
from orchestrator.gateway.stream.targets import JobTargets
from orchestrator.gateway.stream.virtual_groups import VirtualGroups
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.names import split_name
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.operation.recording import JobBegun
from orchestrator.model.report import JobProgress, LeaseState, QueueState
from orchestrator.model.state import ClockMapping, ControllerEvent, ControllerState, LinkTotals

MAX_CONTROLLERS, MAX_LEASES = 2000, 8000  # whatever is published
COUNT_NS = 50 * NS_PER_MS  # period in which some of the states that no reader needs are parsed, for the counts
COUNTED = 50  # states, so that their age grows with the fleet, and not the work

_Take = Callable[[BusSample], None]
_Show = Callable[[StreamNeed, int], dict[str, Any]]


class FleetState:
    """Pass each sample to `take_sample`; `compose` returns the state.

    Values are kept as they arrive and made ready when they are asked for: at most 20 times a second, however often they
    are published. Controllers that no reader needs are only counted, some of them at a time.
    """

    def __init__(self, keys: FleetKeys, clock: Clock) -> None:
        self.fleet: Fleet | None = None
        self.on_unknown_digest: Callable[[], None] = lambda: None
        self.invalid = 0
        self.messages = FleetMessages()
        self.clock_history = ClockHistory()
        self._keys, self._clock = keys, clock
        self._states: dict[str, ControllerState] = {}
        self._received_ns: dict[str, int] = {}
        self._raw: dict[str, bytes] = {}
        self._rests: dict[str, dict[str, float]] = {}
        self._shown: dict[str, dict[str, Any]] = {}
        self._presence = AdapterPresence()
        self._links: dict[str, dict[str, Any]] = {}
        self._leases = LeaseTable(MAX_LEASES)
        self._counts = FleetCounts()
        self._counted_ns: int | None = None
        self._chosen = ChosenNames()
        self.jobs = JobTable()
        self._targets = JobTargets()
        self._virtual = VirtualGroups()
        self._leader: tuple[int, LeaderHeartbeat] | None = None
        self._last_stop: dict[str, Any] | None = None
        self._parts: Mapping[str, _Show] = {
            "controllers": self._show_controllers,
            "leases": self._show_leases,
            "jobs": lambda _, now_ns: {"jobs": self.jobs.show(now_ns)},
            "members": self._show_members,
            "paths": lambda _, __: {"paths": dict(self._targets.paths)},
            "alarms": lambda _, __: {"alarms": dict(self.messages.alarms)},
            "events": lambda _, __: {"events": list(self.messages.events)},
            "queue": lambda _, __: self.jobs.show_queue(),
            "views": lambda _, __: show_views(self.fleet),
            "virtual": lambda _, now_ns: self._virtual.compose(self.fleet, self._targets.by_axis, now_ns),
        }
        self._takers: dict[str, _Take] = {
            "state": self._take_state,
            "event": lambda sample: self.messages.take_event(ControllerEvent.read_message(sample.payload)),
            "link": self._take_link,
            "clock": self._take_mapping,
        }

    @property
    def key_expressions(self) -> tuple[str, ...]:
        """The key expressions to subscribe to, beside the feed of the controllers."""
        keys = self._keys
        jobs = (keys.job_state(), keys.job_begun())
        return (keys.virtual(), *jobs, keys.queue, keys.leases, keys.alarm(), keys.leader)

    @property
    def controllers(self) -> list[str]:
        """The controllers that have published a state."""
        return list(self._received_ns)

    @property
    def is_behind(self) -> bool:
        """Whether states have arrived that are not counted yet."""
        return bool(self._raw)

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
                self._leases.take_lease(LeaseState.read_message(sample.payload))
            elif kind == "alarm":
                self.messages.take_alarm(AlarmRecord.read_message(sample.payload))
            elif kind == "queue":
                self.jobs.take_queue(QueueState.read_message(sample.payload))
            elif kind == "leader":
                self._leader = self._clock.now_ns(), LeaderHeartbeat.read_message(sample.payload)
        except (ValidationError, KeyError):
            self.invalid += 1

    def take_arrival(self, arrival: Arrival) -> None:
        """Store what a host has published."""
        for sample in arrival.samples:
            self.take_sample(sample)
        if arrival.confirmations:
            self._presence.take_carried(arrival.host, arrival.confirmations)
        now_ns = self._clock.now_ns()
        for controller, confirmation in arrival.confirmations.items():
            if controller in self._received_ns:
                self._received_ns[controller] = max(self._received_ns[controller], now_ns - confirmation.age_ns)

    def take_presence(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback of the bus
        """Store that an adapter, or an adapter host, has come or gone."""
        self._presence.take_token(key, present=present)
        self._shown.clear()

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
            self._raw.pop(name, None)
            self._counts.forget(name)
            self._chosen.clear()

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
        if controller not in self._received_ns:
            self._chosen.clear()
        self._received_ns[controller] = self._clock.now_ns()
        self._shown.pop(controller, None)

    def _take_link(self, sample: BusSample) -> None:
        totals = LinkTotals.read_message(sample.payload)
        self._links[totals.controller] = {"bytes_out": totals.bytes_out, "bytes_in": totals.bytes_in}
        self._shown.pop(totals.controller, None)

    def _take_mapping(self, sample: BusSample) -> None:
        self.clock_history.take_mapping(ClockMapping.read_message(sample.payload), self._clock.now_ns())

    def _take_job(self, sample: BusSample, leaf: str) -> None:
        if leaf == "begun":
            self._targets.take_job(JobBegun.read_message(sample.payload))
            return
        progress = JobProgress.read_message(sample.payload)
        if not self.jobs.take_progress(progress, self._clock.now_ns()):
            return
        if self._targets.take_progress(progress, self.fleet, self.find_rest):
            self._shown.clear()

    # What is shown

    def compose(self, need: StreamNeed = EVERYTHING) -> dict[str, Any]:
        """The state now, as far as it is needed, for the stream."""
        now_ns = self._clock.now_ns()
        state: dict[str, Any] = {
            "fleet": self._keys.fleet,
            "utc": f"{self._clock.utc()[:19]}Z",
            "coordinator": show_leader(self._leader, now_ns),
        }
        for part, show in self._parts.items():
            if part in need.parts:
                state |= show(need, now_ns)
        # Behind the controllers, which may have parsed what is counted.
        state["counts"] = self._show_counts(now_ns)
        if self._last_stop is not None:
            state["last_stop"] = self._last_stop
        return state

    def _show_controllers(self, need: StreamNeed, now_ns: int) -> dict[str, Any]:
        return {
            "controllers": {
                name: self._show_controller(name, now_ns) for name in self._chosen.choose(need, self._received_ns)
            }
        }

    def _show_leases(self, need: StreamNeed, _: int) -> dict[str, Any]:
        return {
            "leases": self._leases.show(None if need.patterns is None else self._chosen.choose(need, self._received_ns))
        }

    def _show_members(self, need: StreamNeed, _: int) -> dict[str, Any]:
        """The stage of each needed member of the step that a job runs."""
        members: dict[str, Any] = {}
        for name in self._chosen.choose(need, self._received_ns):
            state = self._states.get(name)
            if state is not None and state.job is not None and state.job in self.jobs:
                job = members.setdefault(state.job, {"step": state.step or 0, "members": {}})
                job["members"][name] = state.mode
        return {"members": members}

    def list_controllers(self, names: Iterable[str]) -> dict[str, Any]:
        """These controllers now, as far as they have published a state."""
        now_ns = self._clock.now_ns()
        return {name: self._show_controller(name, now_ns) for name in names if name in self._received_ns}

    def _show_counts(self, now_ns: int) -> Mapping[str, Any]:
        if self._counted_ns is None or now_ns - self._counted_ns >= COUNT_NS:
            self._counted_ns = now_ns
            for name in list(islice(self._raw, COUNTED)):  # the oldest first
                self._read_state(name)
            self._counts.take_silent(
                name for name, received_ns in self._received_ns.items() if now_ns - received_ns > STALE_NS
            )
        return self._counts.show(len(self._received_ns if self.fleet is None else self.fleet.controllers))

    def _show_controller(self, name: str, now_ns: int) -> dict[str, Any]:
        shown_controller = self._shown.get(name)
        if shown_controller is None:
            shown_controller = self._shown[name] = self._make_controller(name)
        age_s = find_age_s(now_ns - self._received_ns[name])
        return shown_controller if shown_controller.get("age_s") == age_s else {**shown_controller, "age_s": age_s}

    def _make_controller(self, name: str) -> dict[str, Any]:
        present = {"present": self._presence.is_present(name), "age_s": 0}
        state = self._read_state(name)
        if state is None:
            return {**present, "mode": "unknown", "axes": {}}
        config = None if self.fleet is None else self.fleet.controllers.get(name)
        if self.fleet is None or (config is not None and config.digest != state.digest):
            self.on_unknown_digest()
        shown_controller = show_controller(state, config, self._targets.find_targets(name)) | present
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
        self._counts.take_state(name, state)
        rests = self._rests.setdefault(name, {})
        rests |= {axis: axis_now.commanded for axis, axis_now in state.axes.items() if not axis_now.moving}
