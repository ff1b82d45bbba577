"""Recordings that a recorder has left without an index, because it was killed or the disk refused."""

from collections.abc import Iterable
from pathlib import Path

from orchestrator.bus.log import ProcessLog
from orchestrator.clock.executor import Executor
from orchestrator.monitor.recording.file import SUFFIX
from orchestrator.monitor.recording.frames import is_complete
from orchestrator.monitor.recording.repair import RepairFailed, repair_recording


def list_unfinished(path: Path) -> list[Path]:
    """The recordings of a folder without an index, oldest first."""
    paths: list[Path] = []
    for file_path in sorted(path.glob(f"*{SUFFIX}")):
        try:
            with file_path.open("rb") as file:
                if not is_complete(file, file_path.stat().st_size):
                    paths.append(file_path)
        except OSError:
            continue
    return paths


async def repair_left(paths: Iterable[Path], log: ProcessLog, execute: Executor) -> None:
    """Repair what an earlier recorder has left."""
    for path in paths:
        try:
            result = await execute(repair_recording, path)
            log.info(f"repaired {path.name}: {result.messages} messages; {result.reason}")
        except (RepairFailed, OSError) as error:
            log.warning(f"{path} cannot be repaired: {error}")
