"""A router by itself, with the keys of a fleet: it takes a changed access table when the fleet is at rest.

Zenoh reads its access control at the start only. So the router looks at the register and at the fleet file each second,
and opens anew with what they say: when no controller moves or works on a job, or at once behind a stop where the
register demands it. Sessions connect again by themselves.
"""

import asyncio
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from orchestrator.bus.base import BusError
from orchestrator.bus.endpoint import is_socket, split_endpoints, uses_tls
from orchestrator.bus.identity import VARIABLE, BadIdentity, read_identity
from orchestrator.bus.zenoh.kept_latch import keep_latch
from orchestrator.bus.zenoh.own_alarms import report_open_router
from orchestrator.bus.zenoh.router import report_latch_end
from orchestrator.bus.zenoh.sessions import RouterUnreachable, open_router
from orchestrator.client import Tutti
from orchestrator.clock.owner import TaskOwner
from orchestrator.keys.places import find_identity_folder
from orchestrator.keys.register import read_register
from orchestrator.keys.router_settings import make_access_settings, make_tls_settings
from orchestrator.model.errors import Refusal, TuttiError
from orchestrator.model.jobs.files import FileError, load_fleet
from orchestrator.model.state import RESTING_MODES, ControllerState
from orchestrator.runtime.state.folder import ROUTER_LATCH

LOOK_S = 1.0
SAY_AGAIN_S = 600.0  # what is waited for
STOP_S = 10.0  # for the fleet to come to rest before an urgent restart
CLOSED_S = 0.2  # between the end of the old router and the new one


@dataclass(frozen=True, slots=True)
class RouterPlace:
    """listen: endpoints, separated by commas. keys: the folder of the fleet's keys, or of this router. fleet_file:
    which controllers are on which host. state: keeps the e-stop latch. links: endpoints of the other routers of the
    fleet. insecure: it may listen to a network without TLS."""

    listen: str
    keys: Path | None = None
    fleet_file: Path | None = None
    state: Path | None = None
    links: str = ""
    insecure: bool = False


@dataclass(frozen=True, slots=True)
class RouterSecurity:
    """What a router is opened with. settings: Zenoh's. urgent: of the register. identity: the router's folder, which is
    also that of its own session. common_name: of its certificate."""

    settings: dict[str, object]
    fleet: str = ""
    urgent: int = 0
    identity: Path | None = None
    common_name: str = "router.1"

    @property
    def name(self) -> str:
        """The router's name without a generation."""
        return self.common_name.rpartition(".")[0]


def load_security(place: RouterPlace) -> RouterSecurity:
    """Read the keys and the fleet file. Raises `Refusal`, `BadIdentity`, `FileError`, `UnsafePath`."""
    fleet = None if place.fleet_file is None else load_fleet(place.fleet_file)
    name = "" if fleet is None else fleet.fleet
    if place.keys is None:
        return RouterSecurity({}, name)
    if fleet is None:
        text = "the access table needs the fleet file: it says which controllers are on which host"
        raise Refusal("no-fleet-file", text, "give it: `tutti router FLEET --keys DIR`")
    nameless = [
        endpoint for endpoint in split_endpoints(place.listen) if not (uses_tls(endpoint) or is_socket(endpoint))
    ]
    if nameless:
        text = f"with keys nothing listens at {nameless[0]}: sessions there have no names, and so no rights"
        raise Refusal("bad-endpoint", text, "listen at tls/HOST:PORT, or unixsock-stream/PATH")
    register = read_register(place.keys)
    folder = find_identity_folder(place.keys, "router")
    identity = read_identity(folder)
    settings = {**make_tls_settings(identity), **make_access_settings(register, fleet)}
    return RouterSecurity(settings, name, register.urgent, folder, identity.common_name)


@dataclass(slots=True)
class RestWait:
    """The wait for a fleet that rests, which ends with its work: what is to be said of it."""

    _begun_s: float | None = None
    _said_s: float = 0.0
    _busy: str = ""

    def describe(self, busy: str, now_s: float) -> str:
        """What is waited for, when that has changed or was said long ago; else "". busy: what is not at rest."""
        self._begun_s = now_s if self._begun_s is None else self._begun_s
        is_known = busy == self._busy and now_s - self._said_s < SAY_AGAIN_S
        if not busy or is_known:
            return ""
        self._busy, self._said_s = busy, now_s
        line = f"the table has changed; it counts when the fleet is at rest ({busy})"
        minutes = int((now_s - self._begun_s) // 60)
        return f"{line}; waited for {minutes} min: end that work, or `tutti stop`" if minutes else line


class RouterService:
    """Runs a router until it is cancelled. say: takes lines for people."""

    def __init__(self, place: RouterPlace, say: Callable[[str], None]) -> None:
        self._place = place
        self._say = say
        self._security = load_security(place)
        self._problem = ""
        self._wait = RestWait()

    async def run(self, on_ready: Callable[[], None]) -> None:
        """Route. on_ready: called when it listens. Raises `RouterRefused`."""
        while True:
            if self._security.identity is not None:
                os.environ[VARIABLE] = str(self._security.identity)  # of the router's own sessions
            router_place = self._place
            with open_router(
                router_place.listen, self._security.settings, router_place.links, insecure=router_place.insecure
            ):
                on_ready()
                keeping, warnings = TaskOwner(report_latch_end), TaskOwner()
                keeping.spawn(self._keep_latch())
                own, security = self._own_endpoint, self._security
                warnings.spawn(report_open_router(own, router_place.listen, security.fleet, security.name))
                try:
                    self._security = await self._wait_for_change()
                finally:
                    keeping.cancel_all()
                    await warnings.end_all()
                    await keeping.end_all()
            self._say("the router opens anew with the changed table")
            await asyncio.sleep(CLOSED_S)

    async def _keep_latch(self) -> None:
        if self._place.state is None or not self._security.fleet:
            return
        path = self._place.state / ROUTER_LATCH
        await keep_latch(self._own_endpoint, self._security.fleet, self._security.name, path)

    @property
    def _own_endpoint(self) -> str:
        return find_own_endpoint(self._place.listen)

    async def _wait_for_change(self) -> RouterSecurity:
        """Wait until another table is wanted and nothing moves; return it."""
        while True:
            await asyncio.sleep(LOOK_S)
            wanted_security = self._load_again()
            if replace(wanted_security, urgent=0) == replace(self._security, urgent=0):
                self._wait = RestWait()
                continue
            if await self._is_free(urgent=wanted_security.urgent > self._security.urgent):
                return wanted_security

    def _load_again(self) -> RouterSecurity:
        """What is wanted now; what cannot be read is said once, and changes nothing."""
        try:
            wanted_security = load_security(self._place)
        except (TuttiError, FileError, OSError) as error:
            if str(error) != self._problem:
                self._say(f"the present table stays: {error}")
            self._problem = str(error)
            return self._security
        self._problem = ""
        return wanted_security

    async def _is_free(self, *, urgent: bool) -> bool:
        """Whether the router may be opened anew. urgent: the fleet is stopped for it."""
        try:
            async with Tutti(self._own_endpoint, self._security.fleet, actor=self._security.name) as tutti:
                if urgent:
                    self._say("the fleet is stopped, so that a revoked certificate counts no more")
                    await tutti.stop()
                    with suppress(TimeoutError):
                        async with asyncio.timeout(STOP_S):
                            while find_busy((await tutti.status()).values()):
                                await asyncio.sleep(LOOK_S / 5)
                    return True
                busy = find_busy((await tutti.status()).values())
        except (Refusal, BusError, RouterUnreachable, BadIdentity) as error:
            # Then nothing can be moved through this router either.
            self._say(f"the state of the fleet is not known ({error})")
            return True
        line = self._wait.describe(busy, asyncio.get_running_loop().time())
        if line:
            self._say(line)
        return not busy


def find_busy(states: Iterable[ControllerState]) -> str:
    """What is not at rest, in words; "" if everything is."""
    busy = [
        state.controller for state in states if state.mode not in RESTING_MODES or state.job is not None or state.leases
    ]
    return f"at work: {', '.join(sorted(busy))}" if busy else ""


def find_own_endpoint(listen: str) -> str:
    """How this computer reaches the router that listens there. Raises `BadEndpoint`."""
    first = split_endpoints(listen)[0]
    for every, own in (("0.0.0.0", "127.0.0.1"), ("[::]", "[::1]")):
        first = first.replace(f"/{every}:", f"/{own}:")
    return first
