"""A recorder beside a virtual fleet."""

from collections.abc import Callable
from pathlib import Path

from orchestrator.clock.executor import run_inline
from orchestrator.monitor.recording.file import OpenFile, create_file
from orchestrator.monitor.recording.folder import RecorderLimits, RecordingFolder
from orchestrator.monitor.recording.reader import RecordedMessage, Recording
from orchestrator.monitor.recording.recorder import FleetRecorder
from orchestrator.monitor.recording.writer import RecordingWriter
from orchestrator.runtime.virtual.fleet import VirtualFleet


class RecordedFleet:
    """A recorder of `virtual` that writes to `path`. alarms: raised and ended, in order."""

    def __init__(
        self,
        virtual: VirtualFleet,
        path: Path,
        limits: RecorderLimits | None = None,
        open_file: OpenFile = create_file,
        fleet_file: Path | None = None,
    ) -> None:
        self.alarms: list[tuple[str, bool]] = []
        self.path = path
        name, clock = virtual.fleet.fleet, virtual.clock
        self.folder = RecordingFolder(path, name, clock, limits or RecorderLimits(), open_file)
        self.writer = RecordingWriter(self.folder, name, clock, fleet_file)
        self.bus = virtual.net.join_process("recorder")
        self.recorder = FleetRecorder(self.bus, virtual.keys, clock, self.writer, run_inline)
        self.folder.on_alarm = self._note_alarm

    def _note_alarm(self, kind: str, text: str, active: bool) -> None:
        self.alarms.append((kind, active))
        self.recorder.alarms.note_alarm(kind, text, active=active)

    def files(self, kind: str) -> list[Path]:
        """The recordings of jobs (`job`), or of the fleet (`fleet`), by time."""
        return sorted(self.path.glob(f"{kind}-*.mcap"), key=lambda each: each.stat().st_mtime_ns)


def read_messages(path: Path, holds: Callable[[str], bool] = lambda key: True) -> list[RecordedMessage]:
    """The messages of a recording whose keys fit."""
    with Recording(path) as recording:
        return [each for each in recording.read_messages() if holds(each.key)]
