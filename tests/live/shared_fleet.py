"""A fleet whose router, adapter host and coordinators are started apart, with one journal in a database."""

from pathlib import Path

from fleet import COMMAND, EXAMPLES, Entry, ReachedFleet, free_port
from parts import Part

from orchestrator.model.files.private_files import replace_private_file
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.queue import JournalPolicy

NAMES = ("a", "b")


class LedFleet(ReachedFleet):
    """The demo fleet with two coordinators, each with a folder of its name."""

    def log(self, name: str) -> list[Entry]:
        """The log of a process; `coordinator`: of both, in their order."""
        if name != "coordinator":
            return super().log(name)
        return sorted((entry for each in NAMES for entry in self.log_of(each)), key=lambda entry: entry["utc"])

    def log_of(self, coordinator: str) -> list[Entry]:
        return ReachedFleet(self.folder, self.endpoint, self.folder / coordinator).log("coordinator")

    def find_leader(self) -> str:
        """The coordinator with the newest epoch."""
        return max(NAMES, key=lambda name: max((entry.get("epoch") or 0 for entry in self.log_of(name)), default=0))


class SharedFleet(LedFleet):
    """The fleet on one computer. journal: the address of the database. policy: of the fleet file."""

    def __init__(self, folder: Path, journal: str, policy: JournalPolicy) -> None:
        super().__init__(folder, f"tcp/127.0.0.1:{free_port()}", folder / "host")
        self._journal = journal
        self._file = folder / "demo.fleet.json"
        fleet = load_fleet(EXAMPLES / "demo.fleet.yaml")
        replace_private_file(self._file, fleet.model_copy(update={"journal": policy}).to_json())
        self._said = folder / "said"
        self._said.mkdir()
        self.parts: dict[str, Part] = {}

    def start(self) -> None:
        """Start all parts, and wait until a coordinator leads."""
        self._start("router", "router", "--listen", self.endpoint)
        self.parts["router"].wait_for("router on")
        for name in NAMES:
            self.start_coordinator(name)
        host = ("host", "local", "--fleet", "demo", "--connect", self.endpoint, "--sim", "--truth")
        self._start("host", *host, "--state", str(self.state))
        self.parts["host"].wait_for("drives")
        self.works()

    def start_coordinator(self, name: str) -> None:
        """Start a coordinator which leads as soon as no other one does."""
        place = ("--journal", self._journal, "--connect", self.endpoint, "--state", str(self.folder / name))
        self._start(name, "coordinator", str(self._file), *place)

    def close(self) -> None:
        for part in reversed(self.parts.values()):
            part.end()

    def _start(self, name: str, *words: str) -> None:
        self.parts[name] = Part(self._said, "", None, *COMMAND, *words)
