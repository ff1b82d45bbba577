"""A simulated fleet behind a router with TLS and the access table of its keys."""

import os
import shutil
import subprocess
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import zenoh
from children import LIMIT_S, wait_until
from fleet import COMMAND, RunningFleet, free_port
from test_hosts import write_fleet

from orchestrator.bus.identity import VARIABLE
from orchestrator.bus.zenoh.sessions import open_session
from orchestrator.client import Tutti
from orchestrator.keys.folder import KeyFolder
from orchestrator.keys.names import USER_ROLES
from orchestrator.keys.register import read_register, write_register

T = TypeVar("T")


@contextmanager
def identity_of(folder: Path | None) -> Iterator[None]:
    """Sessions that are opened meanwhile have this identity."""
    before = os.environ.pop(VARIABLE, None)
    if folder is not None:
        os.environ[VARIABLE] = str(folder)
    try:
        yield
    finally:
        os.environ.pop(VARIABLE, None)
        if before is not None:
            os.environ[VARIABLE] = before


class KeyedFleet(RunningFleet):
    """The demo fleet, its gantry on adapter host `left`, its stage on `right`, under `tutti up --keys`. Its router
    also listens at a socket, through which `ask` has all rights. right_s: how long the certificate of `right` lasts."""

    def __init__(self, folder: Path, *options: str, right_s: float = 864e5) -> None:
        now = datetime.now(UTC)
        self.keys = KeyFolder(folder / "keys")
        self.keys.init("demo", now, 3650)
        self.keys.add("router", "main", now, addresses=("127.0.0.1",))
        self.keys.add("coordinator", "main", now)
        self.keys.add("host", "left", now)
        self.keys.add("host", "right", now, days=right_s / 86400)
        for role in USER_ROLES:
            self.keys.add(role, "anna", now)
        self.rightless = self._make_rightless(folder / "rightless", now)
        self.tls, socket = f"tls/127.0.0.1:{free_port()}", f"unixsock-stream/{folder}/bus"
        self.fleet_file = write_fleet(folder)
        self.router_said = folder / "router.out"
        command = [*COMMAND, "router", str(self.fleet_file), "--keys", str(self.keys.folder), "--listen"]
        command += [f"{self.tls},{socket}", "--state", str(folder / "router")]
        with self.router_said.open("w") as out:
            self.router = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        try:
            wait_until(lambda: "router on" in self.router_said.read_text(), "the router listens")
        except AssertionError:
            self.router.kill()
            raise AssertionError(self.router_said.read_text()) from None
        with identity_of(None):
            super().__init__(folder, self.fleet_file, "--connect", self.tls, "--keys", str(self.keys.folder), *options)
        self.endpoint = socket

    def _make_rightless(self, folder: Path, now: datetime) -> dict[str, Path]:
        """Identities of the fleet's authority that are not in the router's table."""
        keys = self.keys
        shutil.copytree(keys.identity("viewer-anna"), folder)
        keys.renew("viewer-anna", now)
        keys.add("operator", "revoked", now)
        keys.revoke("operator-revoked")
        register = read_register(keys.folder)
        keys.add("operator", "unknown", now)
        write_register(keys.folder, register)
        return {
            "viewer-anna.1": folder,
            "operator-revoked.1": keys.identity("operator-revoked"),
            "operator-unknown.1": keys.identity("operator-unknown"),
        }

    def identity(self, role: str, name: str = "anna") -> Path:
        return self.keys.identity(f"{role}-{name}")

    def open(self, identity: Path | None) -> zenoh.Session:
        """A session with an identity; without one, with all rights, through the socket."""
        with identity_of(identity):
            return open_session(self.endpoint if identity is None else self.tls)

    def ask_as(self, identity: Path, act: Callable[[Tutti], Coroutine[Any, Any, T]]) -> T:
        """What a client with an identity gets."""
        endpoint, self.endpoint = self.endpoint, self.tls
        try:
            with identity_of(identity):
                return self.ask(act)
        finally:
            self.endpoint = endpoint

    def close(self) -> None:
        super().close()
        if self.router.poll() is None:
            self.router.terminate()
            self.router.wait(LIMIT_S)
