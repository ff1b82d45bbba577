"""The keys of a fleet: made, checked and parsed.

All are below `tutti/v1/{fleet}/`. Ids and verbs are one chunk of `[a-z0-9_-]`. Where an id may be omitted, the
result is the expression for all of them, to subscribe, watch or query.
"""

import re
from dataclasses import dataclass

from orchestrator.model.errors import NoName
from orchestrator.model.text.outside_text import show_text

ROOT = "tutti/v1"

ANY_ESTOP = f"{ROOT}/*/estop"
"""The e-stop of every fleet on the bus."""

ANY_STATE, ANY_TIME = f"{ROOT}/*/ctl/*/state", f"{ROOT}/*/time"
"""What the fleets on a bus are found by."""

ANY_HOST_STATES = f"{ROOT}/*/host/*/states"
"""The frames of every host of every fleet on the bus."""

ANY_OLD_CONTROLLER = f"{ROOT}/*/live/controller/*/*"
"""The controllers of hosts of protocol 1.5, which publish no frames."""

ANY_KEPT_ESTOP = f"{ROOT}/*/kept-estop/*"
"""What a router answers itself, so that a session sees whether its name counts there."""

STANDBY = "standby"
"""The instance in the token of a coordinator that stands by."""

SLOW_START = "slow-start"
"""The instance in the token of an adapter host that is not there yet."""

_ID = re.compile(r"[a-z0-9_-]+")


def check_id(text: str, what: str) -> str:
    """Return `text`. Raises `NoName`, which names `what` it should be, if it cannot be one chunk of a key."""
    if not _ID.fullmatch(text):
        shown_text = show_text(text[:80])
        raise NoName(f"{what} '{shown_text}': allowed are a-z, 0-9, '_' and '-', at least one character")
    return text


def _make_chunk(text: str | None, what: str) -> str:
    return "*" if text is None else check_id(text, what)


@dataclass(frozen=True, slots=True)
class FleetKeys:
    """Makes and parses the keys of one fleet. Every method raises `ValueError` for an invalid id."""

    fleet: str

    def __post_init__(self) -> None:
        check_id(self.fleet, "fleet")

    @property
    def prefix(self) -> str:
        """The common beginning of all keys of the fleet, without the trailing `/`."""
        return f"{ROOT}/{self.fleet}"

    @property
    def everything(self) -> str:
        """The expression for all keys of the fleet."""
        return f"{self.prefix}/**"

    # Controllers

    def state(self, ctl: str | None = None) -> str:
        """Full state of a controller; published and served by its adapter."""
        return self._controller_key(ctl, "state")

    def event(self, ctl: str | None = None) -> str:
        """Events of a controller, which must not be lost; published by its adapter, and served to fill gaps."""
        return self._controller_key(ctl, "event")

    def info(self, ctl: str | None = None) -> str:
        """Identity and capabilities of a controller; served by its adapter."""
        return self._controller_key(ctl, "info")

    def clock(self, ctl: str | None = None) -> str:
        """A controller's clock mapping and its bounds; published by its adapter."""
        return self._controller_key(ctl, "clock")

    def link(self, ctl: str | None = None) -> str:
        """Bytes on a controller's link; published by its adapter."""
        return self._controller_key(ctl, "link")

    def trace(self, ctl: str | None = None) -> str:
        """The last minute of bytes on a controller's link; served by its adapter."""
        return self._controller_key(ctl, "trace")

    def command(self, ctl: str | None = None, verb: str | None = None) -> str:
        """A command to a controller; served by its adapter."""
        return f"{self._controller_key(ctl, 'cmd')}/{_make_chunk(verb, 'verb')}"

    def _controller_key(self, ctl: str | None, leaf: str) -> str:
        return f"{self.prefix}/ctl/{_make_chunk(ctl, 'controller')}/{leaf}"

    def controller(self, ctl: str | None = None) -> str:
        """The expression for all that is published about a controller, and for the values that its adapter serves."""
        return self._controller_key(ctl, "*")

    def host_states(self, host: str | None = None) -> str:
        """Frames with the states of a host's controllers; published by the host, and served: all of them."""
        return f"{self.prefix}/host/{_make_chunk(host, 'host')}/states"

    def host_events(self, host: str | None = None) -> str:
        """Frames with the events of a host's controllers; published by the host."""
        return f"{self.prefix}/host/{_make_chunk(host, 'host')}/events"

    def served_by_host(self, host: str) -> str:
        """The expression for all that a host serves under its own name."""
        return f"{self.prefix}/host/{_make_chunk(host, 'host')}/**"

    def served_of_controller(self, ctl: str | None = None) -> str:
        """The expression that a host serves for a controller, or for all (None): it answers for its own ones only."""
        return f"{self.prefix}/ctl/**" if ctl is None else self._controller_key(ctl, "**")

    def batch_command(self, host: str | None = None, verb: str | None = None) -> str:
        """A command to several controllers of an adapter host; served by the host."""
        return f"{self.prefix}/host/{_make_chunk(host, 'host')}/cmd/{_make_chunk(verb, 'verb')}"

    def lease(self, ctl: str, axis: str | None = None) -> str:
        """The lease of a controller, or of one axis of it; published by the coordinator."""
        key = f"{self.prefix}/lease/{check_id(ctl, 'controller')}"
        return key if axis is None else f"{key}/{check_id(axis, 'axis')}"

    @property
    def controller_leases(self) -> str:
        """The leases of all controllers."""
        return f"{self.prefix}/lease/*"

    @property
    def leases(self) -> str:
        """All leases, of controllers and of axes."""
        return f"{self.prefix}/lease/**"

    # The coordinator

    def job_state(self, job: str | None = None) -> str:
        """Progress of a job; published by the coordinator."""
        return f"{self.prefix}/job/{_make_chunk(job, 'job')}/state"

    def job_report(self, job: str | None = None) -> str:
        """Report of a job; published by the coordinator."""
        return f"{self.prefix}/job/{_make_chunk(job, 'job')}/report"

    def job_begun(self, job: str | None = None) -> str:
        """A job as it began; published by the coordinator."""
        return f"{self.prefix}/job/{_make_chunk(job, 'job')}/begun"

    def job_plan(self, job: str | None = None) -> str:
        """The plans of a job's motion steps, each after the step; published by the coordinator."""
        return f"{self.prefix}/job/{_make_chunk(job, 'job')}/plan"

    def job_samples(self, job: str | None = None) -> str:
        """Positions that controllers have sampled by themselves; published by the coordinator."""
        return f"{self.prefix}/job/{_make_chunk(job, 'job')}/samples"

    def job_live(self, job: str | None = None) -> str:
        """What became of each step that a live job was asked for; published by the coordinator."""
        return f"{self.prefix}/job/{_make_chunk(job, 'job')}/live"

    def job_points(self, job: str | None = None) -> str:
        """Rows of the points of a job's scans, each once; published by the coordinator."""
        return f"{self.prefix}/job/{_make_chunk(job, 'job')}/points"

    def job_triggers(self, job: str | None = None) -> str:
        """What outputs did on the way of a step; published by the coordinator."""
        return f"{self.prefix}/job/{_make_chunk(job, 'job')}/triggers"

    def virtual(self, group: str | None = None) -> str:
        """The state of a group of virtual axes; published by the coordinator."""
        return f"{self.prefix}/virtual/{_make_chunk(group, 'group')}/state"

    @property
    def queue(self) -> str:
        """The queue of jobs; published by the coordinator."""
        return f"{self.prefix}/queue"

    def alarm(self, alarm: str | None = None) -> str:
        """An alarm; published and served by the leader."""
        return f"{self.prefix}/alarm/{_make_chunk(alarm, 'alarm')}"

    def alarm_request(self, role: str | None = None, id: str | None = None) -> str:
        """What another process wants an alarm to be raised for; published by it."""
        return f"{self.prefix}/alarm-request/{_make_chunk(role, 'role')}/{_make_chunk(id, 'id')}"

    def service(self, verb: str | None = None) -> str:
        """Requests of users; served by the leader."""
        return f"{self.prefix}/svc/{_make_chunk(verb, 'verb')}"

    def session(self, session: str | None = None) -> str:
        """Signs of life of a command that a person waits for; published by its client."""
        return f"{self.prefix}/session/{_make_chunk(session, 'session')}"

    @property
    def time(self) -> str:
        """Fleet time; served by the leader."""
        return f"{self.prefix}/time"

    @property
    def leader(self) -> str:
        """The leader's heartbeat, with epoch and uuid."""
        return f"{self.prefix}/leader"

    def leader_answer(self, coordinator: str | None = None) -> str:
        """The heartbeat of one coordinator, as its answer to the question whether it leads; served by it."""
        return f"{self.prefix}/leads/{_make_chunk(coordinator, 'coordinator')}"

    # Common

    @property
    def estop(self) -> str:
        """E-stops, published by any process with `Priority.ESTOP`."""
        return f"{self.prefix}/estop"

    @property
    def estop_reset(self) -> str:
        """Published by a client once every controller has been reset."""
        return f"{self.prefix}/estop-reset"

    def kept_estop(self, keeper: str | None = None) -> str:
        """The e-stop that a process without controllers keeps; served by it."""
        return f"{self.prefix}/kept-estop/{_make_chunk(keeper, 'keeper')}"

    def log(self, role: str | None = None, id: str | None = None) -> str:
        """Warnings and errors."""
        return f"{self.prefix}/log/{_make_chunk(role, 'role')}/{_make_chunk(id, 'id')}"

    def live(self, role: str | None = None, id: str | None = None, instance: str | None = None) -> str:
        """Presence of one start (`instance`) of a process."""
        chunks = (_make_chunk(role, "role"), _make_chunk(id, "id"), _make_chunk(instance, "instance"))
        return "/".join((self.prefix, "live", *chunks))

    def slow_start(self, host: str | None = None) -> str:
        """Presence of an adapter host that its guardian has started, and that is slow to start."""
        return self.live("host", host, SLOW_START)

    # Parsing

    def verb_of(self, key: str) -> str:
        """The verb of a `ctl/{id}/cmd/{verb}`, `host/{id}/cmd/{verb}` or `svc/{verb}` key."""
        chunks = self._split_key(key, ("ctl", "host", "svc"), 2)
        if chunks[0] != "svc" and (len(chunks) != 4 or chunks[2] != "cmd"):
            raise ValueError(f"{key!r} is not a command")
        return check_id(chunks[-1], "verb")

    def _split_key(self, key: str, kinds: tuple[str, ...], at_least: int) -> list[str]:
        head = f"{self.prefix}/"
        if not key.startswith(head):
            raise ValueError(f"{key!r} is not of fleet {self.fleet!r}")
        chunks = key.removeprefix(head).split("/")
        if chunks[0] not in kinds or len(chunks) < at_least or len(chunks) > 4:
            raise ValueError(f"{key!r} is not a key of {' or '.join(kinds)}")
        return chunks
