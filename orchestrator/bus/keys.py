"""The keys of a fleet: how they are built, checked and read back.

All stand under `tutti/v1/{fleet}/`. Ids and verbs are one chunk of `[a-z0-9_-]`. Where an id may be left out, the
result is the expression for all of them, for those who subscribe, watch or ask.
"""

import re
from dataclasses import dataclass

ROOT = "tutti/v1"

_ID = re.compile(r"[a-z0-9_-]+")


def check_id(text: str, what: str) -> str:
    """Give `text` back. Raises `ValueError` naming `what` it should be when it cannot be one chunk of a key."""
    if not _ID.fullmatch(text):
        raise ValueError(f"{what} {text!r}: only a-z, 0-9, '_' and '-' may stand in it, and at least one of them")
    return text


def _chunk(text: str | None, what: str) -> str:
    return "*" if text is None else check_id(text, what)


@dataclass(frozen=True, slots=True)
class Keys:
    """Builds and reads the keys of one fleet. Every method raises `ValueError` for an id that cannot be one."""

    fleet: str

    def __post_init__(self) -> None:
        check_id(self.fleet, "fleet")

    @property
    def prefix(self) -> str:
        """What all keys of the fleet begin with, without the `/` after it."""
        return f"{ROOT}/{self.fleet}"

    # Controllers

    def state(self, ctl: str | None = None) -> str:
        """Full state of a controller; put and answered by its adapter."""
        return self._ctl(ctl, "state")

    def event(self, ctl: str | None = None) -> str:
        """What must not be lost of a controller; put, and answered for gaps, by its adapter."""
        return self._ctl(ctl, "event")

    def info(self, ctl: str | None = None) -> str:
        """What a controller is and can do; answered by its adapter."""
        return self._ctl(ctl, "info")

    def clock(self, ctl: str | None = None) -> str:
        """A controller's clock mapping and its bounds; put by its adapter."""
        return self._ctl(ctl, "clock")

    def cmd(self, ctl: str | None = None, verb: str | None = None) -> str:
        """A command to a controller; answered by its adapter."""
        return f"{self._ctl(ctl, 'cmd')}/{_chunk(verb, 'verb')}"

    def _ctl(self, ctl: str | None, leaf: str) -> str:
        return f"{self.prefix}/ctl/{_chunk(ctl, 'controller')}/{leaf}"

    def together(self, host: str, verb: str | None = None) -> str:
        """A command to several controllers of an adapter host at once; answered by the host."""
        return f"{self.prefix}/host/{check_id(host, 'host')}/cmd/{_chunk(verb, 'verb')}"

    def lease(self, ctl: str, axis: str | None = None) -> str:
        """Who may move a controller, or one axis of it; put by the coordinator."""
        key = f"{self.prefix}/lease/{check_id(ctl, 'controller')}"
        return key if axis is None else f"{key}/{check_id(axis, 'axis')}"

    @property
    def leases(self) -> str:
        """All leases, of controllers and of axes."""
        return f"{self.prefix}/lease/**"

    # The coordinator

    def job_state(self, job: str | None = None) -> str:
        """Progress of a job; put by the coordinator."""
        return f"{self.prefix}/job/{_chunk(job, 'job')}/state"

    def job_report(self, job: str | None = None) -> str:
        """Record of a job; put by the coordinator."""
        return f"{self.prefix}/job/{_chunk(job, 'job')}/report"

    @property
    def queue(self) -> str:
        """The queue of jobs; put by the coordinator."""
        return f"{self.prefix}/queue"

    def svc(self, verb: str | None = None) -> str:
        """What users ask for; answered by the reigning coordinator."""
        return f"{self.prefix}/svc/{_chunk(verb, 'verb')}"

    @property
    def time(self) -> str:
        """Fleet time; answered by the reigning coordinator."""
        return f"{self.prefix}/time"

    @property
    def reign(self) -> str:
        """The coordinator's heartbeat, with epoch and uuid."""
        return f"{self.prefix}/reign"

    # Everybody

    @property
    def estop(self) -> str:
        """Put by anybody with `Priority.ESTOP`, answered by everybody who knows the latch."""
        return f"{self.prefix}/estop"

    def log(self, role: str | None = None, id: str | None = None) -> str:
        """Warnings and worse."""
        return f"{self.prefix}/log/{_chunk(role, 'role')}/{_chunk(id, 'id')}"

    def live(self, role: str | None = None, id: str | None = None, instance: str | None = None) -> str:
        """Presence of one start (`instance`) of a process."""
        return f"{self.prefix}/live/{_chunk(role, 'role')}/{_chunk(id, 'id')}/{_chunk(instance, 'instance')}"

    # Reading back

    def verb_of(self, key: str) -> str:
        """The verb of a `ctl/{id}/cmd/{verb}`, `host/{id}/cmd/{verb}` or `svc/{verb}` key."""
        chunks = self._chunks(key, ("ctl", "host", "svc"), 2)
        if chunks[0] != "svc" and (len(chunks) != 4 or chunks[2] != "cmd"):
            raise ValueError(f"{key!r} is no command")
        return check_id(chunks[-1], "verb")

    def _chunks(self, key: str, kinds: tuple[str, ...], at_least: int) -> list[str]:
        head = f"{self.prefix}/"
        if not key.startswith(head):
            raise ValueError(f"{key!r} is not of fleet {self.fleet!r}")
        chunks = key.removeprefix(head).split("/")
        if chunks[0] not in kinds or len(chunks) < at_least or len(chunks) > 4:
            raise ValueError(f"{key!r} is no key of {' or '.join(kinds)}")
        return chunks
