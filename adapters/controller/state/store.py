"""Adapter memory that survives a crash: e-stop latch, highest epoch seen, user offsets of axes."""

from pathlib import Path
from typing import Any, Protocol

from pydantic import Field

from orchestrator.clock.executor import Executor
from orchestrator.model.base import Int53, Model, Rational
from orchestrator.model.files.private_files import ON_DISK, FileAccess
from orchestrator.model.operation.checksums import add_checksum, take_checksum
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

    async def store_values(self, **fields: Any) -> None:
        """Change values and save them. Raises `OSError`; then these are as before."""
        old_values = {name: getattr(self.values, name) for name in fields}
        self.change_values(**fields)
        try:
            await self.persist()
        except OSError:
            self.change_values(**old_values)
            raise

    async def persist(self) -> None:
        """Save all changes made so far. Raises `OSError`."""
        memory = self.values
        if memory is not self._kept:
            await self._runs(self._store.save, memory)
            self._kept = memory


class FileStore:
    """A store in a small JSON file with a checksum, replaced as a whole and synced to disk; and a copy of it."""

    def __init__(self, path: Path, files: FileAccess = ON_DISK) -> None:
        self._path = path
        self._files = files

    def load(self) -> AdapterMemory:
        """Return the saved memory. An unreadable file counts as a latched e-stop: that is the safe interpretation.
        Epoch and offsets are then those of the copy; without one the offsets are lost."""
        try:
            return self._read_memory(self._path)
        except FileNotFoundError:
            return AdapterMemory()
        except (OSError, ValueError) as error:
            reason = f"{self._path} cannot be read ({type(error).__name__}); reset the e-stop to continue"
        memory_copy = AdapterMemory()
        try:
            memory_copy = self._read_memory(self._copy)
        except (OSError, ValueError):
            reason += ", and check the positions of its axes: offsets that were set are lost"
        latch = EstopLatch(event="unreadable-store", actor="adapter", reason=reason, utc="")
        return memory_copy.model_copy(update={"estop": memory_copy.estop or latch})

    def save(self, memory: AdapterMemory) -> None:
        contents = add_checksum(memory.to_json())
        self._files.replace(self._path, contents)
        self._files.replace(self._copy, contents)

    @property
    def _copy(self) -> Path:
        return self._path.with_name(f"{self._path.name}.copy")

    def _read_memory(self, path: Path) -> AdapterMemory:
        return AdapterMemory.model_validate_json(take_checksum(self._files.read(path)))
