"""The command of a coordinator of a fleet on this machine."""

import os
import sys
from pathlib import Path

from adapters.controller.state.store import FileStore
from orchestrator.runtime.live.run import FleetRun
from orchestrator.runtime.services.parts import COORDINATOR
from orchestrator.runtime.state.folder import ADAPTERS, JOURNAL

EXISTING_JOURNAL = "--existing-journal"


def make_coordinator_command(run: FleetRun, connect: str, state: Path, file: Path) -> list[str]:
    """Make it. state: its folder. file: of the fleet."""
    command = COORDINATOR.make_command(sys.executable, "--fleet", str(file), "--connect", connect)
    command += ["--journal", run.journal or str(state / JOURNAL), "--state", str(state)]
    command += ["--log", str(state / "log" / "coordinator.jsonl"), "--parent", str(os.getpid())]
    if not run.journal and had_journal(state) and not run.new_journal:
        command.append(EXISTING_JOURNAL)
    flags = {"--take-over": run.take_over, "--patient": run.patient}
    return [*command, *(name for name, is_given in flags.items() if is_given)]


def had_journal(folder: Path) -> bool:
    """Whether a coordinator has led a fleet with this state folder, and so had a journal there."""
    stored_memories = [FileStore(path).load() for path in (folder / ADAPTERS).glob("*.json")]
    return (folder / f"{JOURNAL}.reign").exists() or any(memory.epoch for memory in stored_memories)
