"""The e-stop latch of a process that drives no controller: kept, stored, and handed to adapter hosts that start.

An adapter host that is restarting receives no e-stop. Every coordinator, leading or standing by, every guardian and the
router's process keep the latch until it is reset; an adapter compares before it can be adopted.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusDeclaration, BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.executor import Executor, run_inline
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.errors import TuttiError
from orchestrator.model.files.private_files import ON_DISK, FileAccess
from orchestrator.model.messages import EstopMessage, EstopReset, KeptEstop
from orchestrator.model.operation.checksums import add_checksum, take_checksum
from orchestrator.model.state import EstopLatch


def read_estop(payload: bytes, utc: str) -> EstopLatch:
    """The latch of an e-stop that was received at `utc`. Every sample on its key counts, also an unreadable one."""
    try:
        estop = EstopMessage.read_message(payload)
    except ValidationError:
        estop = EstopMessage(event="garbled", actor="unknown", reason="an e-stop whose payload could not be read")
    return EstopLatch(event=estop.event, actor=estop.actor, reason=estop.reason, utc=utc)


class LatchStore(Protocol):
    """Storage for a latch that outlives the process."""

    def load(self) -> EstopLatch | None: ...

    def save(self, latch: EstopLatch | None) -> None:
        """Save it, or that there is none. Raises `OSError`."""
        ...


class LatchKeeper:
    """Keeps the first e-stop since the last reset. execute: saves it; a slow disk must not delay the process."""

    def __init__(
        self, bus: Bus, keys: FleetKeys, utc: Callable[[], str], store: LatchStore, execute: Executor = run_inline
    ) -> None:
        self._bus = bus
        self._keys = keys
        self._utc = utc
        self._store = store
        self._execute = execute
        self._saves = TaskOwner()
        self._declared: list[BusDeclaration] = []
        self.latch: EstopLatch | None = store.load()

    async def start(self, name: str) -> None:
        """Receive e-stops and resets, and answer with the latch. name: of this keeper, unique on the bus."""
        self._declared = [
            await self._bus.subscribe(self._keys.estop, self._receive_estop),
            await self._bus.subscribe(self._keys.estop_reset, self._receive_reset),
            await self._bus.serve(self._keys.kept_estop(name), self._answer),
        ]

    def find_event(self) -> str:
        """The event of the kept e-stop; empty: none."""
        return "" if self.latch is None else self.latch.event

    async def close(self) -> None:
        """Leave the bus. The stored latch stays."""
        for declaration in self._declared:
            await declaration.undeclare()
        self._declared.clear()
        await asyncio.gather(*self._saves.pending)

    def _receive_estop(self, sample: BusSample) -> None:
        if self.latch is None:
            self._change(read_estop(sample.payload, self._utc()))

    def _receive_reset(self, sample: BusSample) -> None:
        """A reset that cannot be read, or is of another e-stop, resets nothing."""
        with suppress(ValidationError):
            reset = EstopReset.read_message(sample.payload)
            if self.latch is not None and reset.event in (None, self.latch.event):
                self._change(None)

    def _change(self, latch: EstopLatch | None) -> None:
        self.latch = latch
        # In the order of the changes, which is that of the calls.
        self._saves.spawn(self._save(latch))

    async def _save(self, latch: EstopLatch | None) -> None:
        # A full disk takes nothing from what this process knows.
        with suppress(OSError, TuttiError):
            await self._execute(self._store.save, latch)

    async def _answer(self, _: BusSample) -> bytes:
        return KeptEstop(estop=self.latch).to_json()


class FileLatchStore:
    """A store in a small JSON file with a checksum, replaced as a whole and synced to disk. Without the file nothing is
    latched."""

    def __init__(self, path: Path, files: FileAccess = ON_DISK) -> None:
        self._path = path
        self._files = files

    def load(self) -> EstopLatch | None:
        """The stored latch. An unreadable file counts as a latched e-stop: that is the safe interpretation."""
        try:
            return KeptEstop.model_validate_json(take_checksum(self._files.read(self._path))).estop
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            reason = f"{self._path} cannot be read ({type(error).__name__}); reset the e-stop to continue"
            return EstopLatch(event="unreadable-store", actor=self._path.name, reason=reason, utc="")

    def save(self, latch: EstopLatch | None) -> None:
        self._files.replace(self._path, add_checksum(KeptEstop(estop=latch).to_json()))
