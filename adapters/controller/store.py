"""What an adapter remembers over its own death: e-stop latch, highest epoch seen, user offsets of axes."""

import os
from pathlib import Path
from typing import Any, Protocol

from pydantic import Field, ValidationError

from orchestrator.clock.executor import Runs
from orchestrator.model.base import Int53, Model, Rational
from orchestrator.model.state import EstopLatch


class Memory(Model):
    """The remembered values. offsets: by axis, in its unit."""

    epoch: Int53 = 0
    coordinator: str = ""
    estop: EstopLatch | None = None
    offsets: dict[str, Rational] = Field(default={})


class Store(Protocol):
    """Where one controller's memory is kept."""

    def load(self) -> Memory: ...

    def save(self, memory: Memory) -> None:
        """Keep `memory`; it is safe when this returns."""
        ...


class Remembered:
    """The memory at hand: changed at once, and safe after `keep`."""

    def __init__(self, store: Store, runs: Runs) -> None:
        self._store = store
        self._runs = runs
        self.now = self._kept = store.load()

    def change(self, **fields: Any) -> None:
        self.now = self.now.model_copy(update=fields)

    async def keep(self) -> None:
        """What has been changed so far is safe when this returns. Raises `OSError`."""
        memory = self.now
        if memory is not self._kept:
            await self._runs(self._store.save, memory)
            self._kept = memory


class MemoryStore:
    """A store in memory that outlives a virtual process, as a disk does."""

    def __init__(self) -> None:
        self._memory = Memory()

    def load(self) -> Memory:
        return self._memory

    def save(self, memory: Memory) -> None:
        self._memory = memory


class FileStore:
    """A store in a small JSON file, replaced as a whole and synced to disk."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> Memory:
        """What was saved. A file that can not be read counts as a latched e-stop: that is the safe reading."""
        try:
            return Memory.model_validate_json(self._path.read_bytes())
        except FileNotFoundError:
            return Memory()
        except (OSError, ValidationError) as error:
            reason = f"{self._path} can not be read ({type(error).__name__}); reset the e-stop to go on"
            return Memory(estop=EstopLatch(event="unreadable-store", actor="adapter", reason=reason, utc=""))

    def save(self, memory: Memory) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        fresh = self._path.with_suffix(".new")
        with fresh.open("wb") as file:
            file.write(memory.to_json())
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(self._path)
