"""The state folder of a running fleet: one `tutti up` at a time locks it, and says there which process it is."""

import json
import os
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from orchestrator.model.errors import TuttiError
from orchestrator.model.files.locks import lock_file_now
from orchestrator.model.files.private_files import UnsafePath, make_private_folder, open_private_file, restrict_to_user

LOCK = "lock"
JOURNAL = "journal.sqlite3"
ROUTER_LATCH = "estop-router.json"
UP_LOG = "up.log"  # in the folder `log`: what a detached `tutti up` says
USERS_FILE = "users.json"  # of the page, with hashed passwords
FLEET_FILE = "fleet.json"  # the fleet as it runs
ADAPTERS = "adapters"  # the folder of what adapters keep
RECORDINGS = "recordings"  # the folder of the recorder's files
_FOLDERS = (ADAPTERS, RECORDINGS, "log", "ports", "truth", "world")


class UpFailed(TuttiError):
    """The fleet cannot be started. The text names the part, the reason, and the remedy."""


@dataclass(frozen=True, slots=True)
class RunningFleet:
    """A `tutti up` at work, or a `tutti host` (adapter_host: its name). started: when its process began, in the
    kernel's ticks, which tells it from a later process with the same id."""

    pid: int
    started: int
    fleet: str
    connect: str
    folder: Path
    adapter_host: str = ""


class StateLock:
    """The lock of a state folder, held until `release` or the end of the process."""

    def __init__(self, folder: Path) -> None:
        """Lock it: two fleets with one journal, or one set of simulated ports, would interfere. Raises `UpFailed`."""
        try:
            make_private_folder(folder)
            _restrict_folder(folder)
            # Not truncated before it is locked: it belongs to the process that holds it.
            lock = open_private_file(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_APPEND)
            self._file: TextIO = os.fdopen(lock, "a+", encoding="utf-8")
        except UnsafePath as error:
            raise UpFailed(str(error)) from None
        except OSError as error:
            raise UpFailed(f"{folder} cannot be used: {error.strerror}; choose another folder: --state") from None
        try:
            lock_file_now(self._file.fileno())
        except BlockingIOError:
            self._file.close()
            remedy = f"end that one (`tutti down --state {folder}`, Ctrl-C), or choose another folder: --state"
            raise UpFailed(f"another `tutti up` uses {folder}, or a `tutti sim serve`; {remedy}") from None
        self._file.truncate(0)

    def describe_fleet(self, fleet: str, connect: str, adapter_host: str = "") -> None:
        """Write which fleet runs, and in which process; or which adapter host of it."""
        pid = os.getpid()
        entry: dict[str, object] = {"pid": pid, "started": find_start_ticks(pid), "fleet": fleet, "connect": connect}
        entry["adapter_host"] = adapter_host
        self._file.truncate(0)
        self._file.write(json.dumps({**entry, "host": socket.gethostname()}))
        self._file.flush()

    def release(self) -> None:
        """Release it. Safe to call twice."""
        if not self._file.closed:
            self._file.truncate(0)
            self._file.close()


def _restrict_folder(folder: Path) -> None:
    """Take a state folder, with what earlier versions created in it, from other users. Raises `UnsafePath`."""
    restrict_to_user(folder)
    for inner in [folder / name for name in _FOLDERS]:
        restrict_to_user(inner)
        for state_file in inner.glob("*") if inner.name != "ports" else ():
            restrict_to_user(state_file)
    for state_file in (*folder.glob(f"{JOURNAL}*"), folder / FLEET_FILE, folder / LOCK):
        restrict_to_user(state_file)


def find_running_fleet(folder: Path) -> RunningFleet | None:
    """The fleet that runs with this state folder; None without one."""
    try:
        entry = json.loads((folder / LOCK).read_text(encoding="utf-8"))
        fields = entry["fleet"], entry["connect"], folder, entry.get("adapter_host", "")
        fleet = RunningFleet(entry["pid"], entry["started"], *fields)
        is_local = entry["host"] == socket.gethostname()
    except (OSError, ValueError, KeyError, TypeError):
        return None
    # What a killed process has left there names no living one.
    return fleet if is_local and find_start_ticks(fleet.pid) == fleet.started else None


def find_running_fleets(adapter_host: str = "") -> list[RunningFleet]:
    """All fleets of this user that run with their default state folders, by name; with a name, those of which this
    adapter host runs by `tutti host`."""
    folders = sorted(path.parent for path in default_state("any").parent.glob(f"*/{LOCK}"))
    running_folders = [fleet for folder in folders if (fleet := find_running_fleet(folder)) is not None]
    return [running_fleet for running_fleet in running_folders if running_fleet.adapter_host == adapter_host]


def default_state(fleet: str) -> Path:
    """Return `$XDG_STATE_HOME/tutti/FLEET`, or below `~/.local/state`."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "tutti" / fleet


def find_start_ticks(pid: int) -> int | None:
    """When a process began, in the kernel's ticks after its start; None if it has ended."""
    try:
        # The name of the program, in brackets, may contain anything.
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] == "Z" else int(fields[19])
