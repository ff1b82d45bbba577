"""Adapter memory that survives a crash: e-stop latch, highest epoch seen, user offsets of axes."""

from pathlib import Path
from typing import Any, Protocol

from pydantic import Field, ValidationError

from orchestrator.clock.executor import Executor
from orchestrator.model.base import Int53, Model, Rational
from orchestrator.model.private_files import read_private_file, replace_private_file
from orchestrator.model.state import EstopLatch


class AdapterMemory(Model):
    """The persistent values. offsets: by axis, in its unit."""

    epoch: Int53 = 0
    coordinator: str = ""
    estop: EstopLatch | None = None
    offsets: dict[str, Rational] = Field(default={})


class AdapterStore(Protocol):
    """Storage for one controller's memory."""

    def load(self) -> AdapterMemory: ...

    def save(self, memory: AdapterMemory) -> None:
        """Save `memory`; it is on disk when this returns."""
        ...


class PersistentMemory:
    """The memory of one controller: changed at once, and saved by `persist`."""

    def __init__(self, store: AdapterStore, runs: Executor) -> None:
        self._store = store
        self._runs = runs
        self.values = self._kept = store.load()

    def change_values(self, **fields: Any) -> None:
        self.values = self.values.model_copy(update=fields)

    async def persist(self) -> None:
        """Save all changes made so far. Raises `OSError`."""
        memory = self.values
        if memory is not self._kept:
            await self._runs(self._store.save, memory)
            self._kept = memory


class VolatileStore:
    """A store in memory that outlives a virtual process, as a disk does."""

    def __init__(self) -> None:
        self._memory = AdapterMemory()

    def load(self) -> AdapterMemory:
        return self._memory

    def save(self, memory: AdapterMemory) -> None:
        self._memory = memory


class FileStore:
    """A store in a small JSON file, replaced as a whole and synced to disk."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> AdapterMemory:
        """Return the saved memory. An unreadable file counts as a latched e-stop: that is the safe interpretation."""
        try:
            return AdapterMemory.model_validate_json(read_private_file(self._path))
        except FileNotFoundError:
            return AdapterMemory()
        except (OSError, ValidationError) as error:
            reason = f"{self._path} cannot be read ({type(error).__name__}); reset the e-stop to continue"
            return AdapterMemory(estop=EstopLatch(event="unreadable-store", actor="adapter", reason=reason, utc=""))

    def save(self, memory: AdapterMemory) -> None:
        replace_private_file(self._path, memory.to_json())
