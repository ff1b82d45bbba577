"""The state that an adapter keeps across its own restart."""

import asyncio
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from adapters.controller.state.fencing import EpochFence
from adapters.controller.state.store import AdapterMemory, FileStore, PersistentMemory
from orchestrator.clock.executor import ThreadExecutor, run_inline
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import AdoptRequest, LeaderHeartbeat
from orchestrator.model.state import EstopLatch

LATCH = EstopLatch(event="e1", actor="anna", reason="a hand in the machine", utc="2026-11-23T04:00:00Z")


class Disk:
    """A store that counts its writes, and that can be full."""

    def __init__(self) -> None:
        self._memory = AdapterMemory()
        self.saved: list[int] = []
        self.full = False

    def load(self) -> AdapterMemory:
        return self._memory

    def save(self, memory: AdapterMemory) -> None:
        if self.full:
            raise OSError("no space left on device")
        self.saved.append(memory.epoch)
        self._memory = memory


def test_stored_values_are_restored(tmp_path: Path) -> None:
    store = FileStore(tmp_path / "state" / "gantry.json")
    assert store.load() == AdapterMemory()

    async def change() -> None:
        remembered = PersistentMemory(store, run_inline)
        remembered.change_values(epoch=7, coordinator="c1")
        remembered.change_values(estop=LATCH)
        await remembered.persist()

    asyncio.run(change())
    again = PersistentMemory(FileStore(tmp_path / "state" / "gantry.json"), run_inline).values
    assert (again.epoch, again.coordinator, again.estop) == (7, "c1", LATCH)


@pytest.mark.parametrize("content", [b"", b"{", b'{"epoch": "many"}', b"\xff\xfe"])
def test_an_unreadable_file_counts_as_an_estop(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "gantry.json"
    path.write_bytes(content)
    latch = FileStore(path).load().estop
    assert latch is not None and latch.event == "unreadable-store"
    assert str(path) in latch.reason and "reset" in latch.reason


def test_what_an_unreadable_file_contained_is_taken_from_its_copy(tmp_path: Path) -> None:
    """All but the latch: that it was not latched is no longer known."""
    path = tmp_path / "gantry.json"
    FileStore(path).save(AdapterMemory(epoch=7, coordinator="c1", offsets={"x": Fraction(5, 2)}))
    whole = path.read_bytes()
    for place in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << place % 8
        path.write_bytes(damaged)
        memory = FileStore(path).load()
        assert (memory.epoch, memory.coordinator, memory.offsets) == (7, "c1", {"x": Fraction(5, 2)})
        assert memory.estop is not None and memory.estop.event == "unreadable-store"
    (tmp_path / "gantry.json.copy").unlink()
    latch = FileStore(path).load().estop
    assert latch is not None and "check the positions of its axes" in latch.reason


def test_a_file_without_a_checksum_is_read(tmp_path: Path) -> None:
    path = tmp_path / "gantry.json"
    path.write_bytes(AdapterMemory(epoch=7).to_json())
    assert FileStore(path).load() == AdapterMemory(epoch=7)


def test_changes_reach_the_disk_in_their_order(tmp_path: Path) -> None:
    async def main() -> None:
        store = FileStore(tmp_path / "gantry.json")
        remembered = PersistentMemory(store, ThreadExecutor("memory"))
        keeping: list[asyncio.Task[None]] = []
        for epoch in range(1, 30):
            remembered.change_values(epoch=epoch)
            keeping.append(asyncio.get_running_loop().create_task(remembered.persist()))
            await asyncio.sleep(0)
        await asyncio.gather(*keeping)
        assert store.load().epoch == 29

    asyncio.run(main())


def test_stored_values_are_not_written_again_but_failed_writes_are_repeated() -> None:
    async def main() -> None:
        disk = Disk()
        remembered = PersistentMemory(disk, run_inline)
        await remembered.persist()
        remembered.change_values(epoch=1)
        await remembered.persist()
        await remembered.persist()
        assert disk.saved == [1]
        remembered.change_values(epoch=2)
        disk.full = True
        with pytest.raises(OSError, match="no space"):
            await remembered.persist()
        disk.full = False
        await remembered.persist()
        assert disk.saved == [1, 2] and disk.load().epoch == 2

    asyncio.run(main())


def adoption(epoch: int) -> AdoptRequest:
    reign = LeaderHeartbeat(
        fleet="lab",
        epoch=epoch,
        coordinator="c1",
        seq=1,
        scale_id="s1",
        kernel_id="k1",
        origin_host_ns=0,
        utc="2026-11-23T04:00:00Z",
    )
    return AdoptRequest(request_id=f"r{epoch}", actor="coordinator", epoch=epoch, coordinator="c1", leader=reign)


@pytest.mark.parametrize("before", [False, True])
def test_a_leader_whose_epoch_cannot_be_stored_is_not_adopted(before: bool) -> None:
    """Neither at first, nor after an earlier leader: the work that it left is still to be dropped."""

    async def main() -> None:
        disk = Disk()
        fence = EpochFence(PersistentMemory(disk, run_inline))
        fence.allow_adoption()
        if before:
            assert await fence.adopt_leader(adoption(2))
        adopt = adoption(3)
        disk.full = True
        with pytest.raises(OSError, match="no space"):
            await fence.adopt_leader(adopt)
        with pytest.raises(Refusal):
            await fence.require_current_leader(adopt)
        disk.full = False
        assert await fence.adopt_leader(adopt)
        await fence.require_current_leader(adopt)
        assert disk.load().epoch == 3

    asyncio.run(main())


def test_a_request_while_an_epoch_is_being_stored_waits_until_the_previous_work_is_dropped() -> None:
    async def main() -> None:
        done: list[str] = []

        async def slowly(function: Callable[..., Any], *values: Any) -> Any:
            await asyncio.sleep(0.01)
            return function(*values)

        fence = EpochFence(PersistentMemory(Disk(), slowly))
        fence.allow_adoption()

        async def adopts() -> None:
            assert await fence.adopt_leader(adoption(2))
            done.append("dropped")

        async def asks() -> None:
            await fence.require_current_leader(adoption(2))
            done.append("leased")

        await fence.adopt_leader(adoption(1))
        await asyncio.gather(adopts(), asks(), asks())
        assert done == ["dropped", "leased", "leased"]

    asyncio.run(main())
