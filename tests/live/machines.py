"""Three computers as network namespaces on one bridge: each has a database, two of them a router and a coordinator, the
third one the adapter host. Any of the two can die, or be cut off."""

import os
import re
import shutil
import subprocess
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from children import wait_until
from fleet import COMMAND, EXAMPLES
from parts import Part
from shared_fleet import NAMES, LedFleet
from unit.journal.servers import Place, PostgresServer, find_programs

from orchestrator.clock.live import raw_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.files.private_files import replace_private_file
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.queue import JournalPolicy

NETWORK = "198.18.77"  # RFC 2544: of no real network
NUMBERS = {"a": 1, "b": 2, "c": 3}
LEADING: tuple[str, ...] = NAMES
ROUTER_PORT, SERVER_PORT = 7447, 5432
BRIDGE = "tutti-br"


def run(*words: str) -> None:
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(words)}: {done.stderr}"


@contextmanager
def make_networks() -> Generator[None]:
    """The bridge, with the test's own address, and the namespaces; skips the test where they are not allowed."""
    if os.geteuid() != 0 or shutil.which("ip") is None or shutil.which("bridge") is None:
        pytest.skip("network namespaces need root, `ip` and `bridge`")
    remove_leftovers()
    with ExitStack() as stack:
        try:
            run("ip", "link", "add", BRIDGE, "type", "bridge")
        except AssertionError as error:
            pytest.skip(f"network namespaces and bridges are not allowed here: {error}")
        stack.callback(run, "ip", "link", "delete", BRIDGE)
        run("ip", "address", "add", f"{NETWORK}.254/24", "dev", BRIDGE)
        run("ip", "link", "set", BRIDGE, "up")
        for name, number in NUMBERS.items():
            namespace, port = name_namespace(name), name_port(name)
            run("ip", "netns", "add", namespace)
            stack.callback(run, "ip", "netns", "delete", namespace)
            run("ip", "link", "add", port, "type", "veth", "peer", "name", "eth0", "netns", namespace)
            # By name: a namespace lives on until the last of its processes has ended.
            stack.callback(run, "ip", "link", "delete", port)
            run("ip", "link", "set", port, "master", BRIDGE, "up")
            run("ip", "-n", namespace, "link", "set", "lo", "up")
            run("ip", "-n", namespace, "address", "add", f"{NETWORK}.{number}/24", "dev", "eth0")
            run("ip", "-n", namespace, "link", "set", "eth0", "up")
        yield


def remove_leftovers() -> None:
    """Remove the networks of a test process that was killed: their bridge would stop all later ones."""
    listed = subprocess.run(("ip", "netns", "list"), check=False, capture_output=True, text=True).stdout
    namespaces = re.findall(r"^tutti-m[abc]-\d+", listed, re.MULTILINE)
    left = [name for name in namespaces if not Path("/proc", name.rpartition("-")[2]).exists()]
    for namespace in left:
        run("ip", "netns", "delete", namespace)
    if left == namespaces:
        for link in (BRIDGE, *map(name_port, NUMBERS)):
            subprocess.run(("ip", "link", "delete", link), check=False, capture_output=True)


def name_namespace(computer: str) -> str:
    return f"tutti-m{computer}-{os.getpid()}"


def name_port(computer: str) -> str:
    """The port of the bridge at which a computer is."""
    return f"tutti-p{computer}"


def find_place(computer: str) -> Place:
    return Place(name_namespace(computer), f"{NETWORK}.{NUMBERS[computer]}", SERVER_PORT)


class Machines(LedFleet):
    """The demo fleet on three computers, with its journal on two of them."""

    def __init__(self, folder: Path) -> None:
        endpoints = [f"tcp/{NETWORK}.{NUMBERS[name]}:{ROUTER_PORT}" for name in LEADING]
        super().__init__(folder, ",".join(endpoints), folder / "c")
        self._endpoints = dict(zip(LEADING, endpoints, strict=True))
        self._said = folder / "said"
        self._said.mkdir()
        self._file = folder / "demo.fleet.json"
        fleet = load_fleet(EXAMPLES / "demo.fleet.yaml").model_copy(update={"journal": JournalPolicy(copies=2)})
        replace_private_file(self._file, fleet.model_copy(update={"routers": endpoints}).to_json())
        hosts = ",".join(f"{place.address}:{place.port}" for place in map(find_place, NUMBERS))
        self._journal = f"postgresql://tutti@{hosts}/journal"
        self.servers: dict[str, PostgresServer] = {}
        self.primary = "a"
        self._parts: dict[tuple[str, str], Part] = {}
        self.lost_ns = 0
        """When a computer was last lost, host time."""

    # Life

    def start(self) -> None:
        """Start all parts, and wait until a coordinator leads."""
        first = self.servers["a"] = PostgresServer(find_programs(), place=find_place("a"))
        first.create("wal_keep_size = 64MB")
        first.execute("CREATE DATABASE journal")
        for name in ("b", "c"):
            self._add_standby(name)
        for server in self.servers.values():
            server.add_settings("synchronous_standby_names = 'ANY 1 (a, b, c)'")
            server.execute("SELECT pg_reload_conf()")
        for name in LEADING:
            self._start_router(name)
        for name in LEADING:
            self._start_coordinator(name)
        host = ("host", "local", "--fleet", "demo", "--connect", self.endpoint, "--sim", "--truth")
        self._start("c", "host", *host, "--state", str(self.state))
        self._parts["c", "host"].wait_for("drives")
        self.works()
        wait_until(lambda: self.mode == "two copies" and self.has_standby(), "two copies, and a standby")

    def close(self) -> None:
        for part in reversed(self._parts.values()):
            part.end()
        for server in self.servers.values():
            server.remove()

    def kill(self, computer: str) -> None:
        """A computer dies: its network is silent from one instant on, and nothing of it lives."""
        run("ip", "-n", name_namespace(computer), "link", "set", "eth0", "down")
        self.lost_ns = raw_ns()
        for kind in ("router", "coordinator"):
            self._parts.pop((computer, kind)).kill()
        self.servers[computer].kill()

    def promote(self) -> None:
        """What a site does when its primary is dead: promote the standby that has most; the other one follows it."""
        alive = [name for name in NUMBERS if name != self.primary]
        place = "SELECT pg_last_wal_receive_lsn() - '0/0'"
        alive.sort(key=lambda name: int(str(self.servers[name].execute(place)[0][0])))
        other, self.primary = alive
        self.servers[self.primary].promote()
        self.servers[other].follow(self.servers[self.primary], other)

    def revive(self, computer: str) -> None:
        """A dead computer comes back, its database as a new standby."""
        run("ip", "-n", name_namespace(computer), "link", "set", "eth0", "up")
        self._start_router(computer)
        self._start_coordinator(computer)
        self.rejoin(computer)

    def rejoin(self, computer: str) -> None:
        """What a site does with a former primary: its database follows the present one."""
        self.servers.pop(computer).remove()
        self._add_standby(computer)
        wait_until(lambda: self.mode == "two copies" and self.has_standby(), "two copies, and a standby")

    def move_primary(self, computer: str) -> None:
        """Make the database of this computer the primary, as a site does that takes one over to another computer."""
        if self.primary == computer:
            return
        former, others = self.primary, [name for name in NUMBERS if name not in (self.primary, computer)]
        self.servers[former].stop()
        self.primary = computer
        self.servers[computer].promote()
        for name in others:
            self.servers[name].follow(self.servers[computer], name)
        self.rejoin(former)

    def cut(self, *computers: str) -> None:
        """Cut the network between these; each reaches all others."""
        for name in computers:
            run("bridge", "link", "set", "dev", name_port(name), "isolated", "on")

    def cut_off(self, computer: str) -> None:
        """Cut a computer off from all others; its processes go on."""
        run("ip", "link", "set", name_port(computer), "down")
        self.lost_ns = raw_ns()

    def mend(self, *computers: str) -> None:
        for name in computers:
            run("bridge", "link", "set", "dev", name_port(name), "isolated", "off")
            run("ip", "link", "set", name_port(name), "up")

    # What is seen

    @property
    def mode(self) -> str:
        """On how many machines the journal is, as the queue says; empty while no coordinator answers."""
        try:
            return self.ask(lambda tutti: tutti.list_jobs(limit=1)).journal or ""
        except Refusal:
            return ""

    def read_output(self, computer: str, kind: str) -> str:
        return self._parts[computer, kind].said.read_text()

    # Parts

    def _add_standby(self, computer: str) -> None:
        self.servers[computer] = self.servers[self.primary].make_standby(computer, find_place(computer))

    def _start_router(self, computer: str) -> None:
        (other,) = (name for name in LEADING if name != computer)
        listen = f"tcp/0.0.0.0:{ROUTER_PORT}"
        self._start(computer, "router", "router", "--listen", listen, "--link", self._endpoints[other], "--insecure")
        self._parts[computer, "router"].wait_for("router on")

    def _start_coordinator(self, computer: str) -> None:
        own_first = sorted(self._endpoints.values(), key=lambda endpoint: endpoint != self._endpoints[computer])
        place = ("--connect", ",".join(own_first), "--state", str(self.folder / computer))
        self._start(computer, "coordinator", "coordinator", str(self._file), "--journal", self._journal, *place)

    def _start(self, computer: str, kind: str, *words: str) -> None:
        self._parts[computer, kind] = Part(self._said, name_namespace(computer), None, *COMMAND, *words)
