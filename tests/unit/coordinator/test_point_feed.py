"""Rows of points on their way out: how many messages, how large, and what a journal that fails leaves."""

import asyncio
from collections.abc import Sequence
from typing import Any

import pytest

from orchestrator.bus.budgets import POINT_BYTES
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.memory.bus import MemoryNet
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.jobs.run.point_feed import PointFeed, PointPublisher
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.model.operation.recording import JobPoints
from orchestrator.model.report import PointRecord, PointWindow, TimeInterval

NAMES = [f"{'controller' * 6}{k}.{'axis' * 15}{k}" for k in range(32)]
WINDOW = PointWindow(
    lower=TimeInterval(earliest_ns=2**52, latest_ns=2**52),
    middle=TimeInterval(earliest_ns=2**52, latest_ns=2**52),
    upper=TimeInterval(earliest_ns=2**52, latest_ns=2**52),
)


def make_row(point: int, axes: Sequence[str] = ("gantry.x", "gantry.y")) -> PointRecord:
    positions = dict.fromkeys(axes, (100.123456789, 100.234567891))
    return PointRecord(
        step=2,
        point=point,
        state="done",
        verdict="green",
        t0_fleet_ns=2**52,
        took_s=0.001,
        target=dict.fromkeys(axes, 1 / 3),
        measured=dict.fromkeys(axes, 2 / 3),
        window=WINDOW.model_copy(update={"positions": positions}),
        good=True,
    )


async def store_nothing(_: Sequence[PointRecord]) -> None:
    return


def test_rows_leave_at_once_and_then_at_most_twenty_times_a_second() -> None:
    async def main(clock: VirtualClock) -> None:
        came: list[tuple[int, int]] = []
        feed = PointFeed(clock, lambda rows: came.append((clock.now_ns(), len(rows))), store_nothing)
        for point in range(1000):
            feed.add_rows([make_row(point)])
            await asyncio.sleep(0.001)
        assert came[0] == (0, 1) and len(came) in (20, 21)
        await feed.finish()
        assert sum(count for _, count in came) == 1000
        # After a pause a row leaves at once again.
        await asyncio.sleep(1)
        feed.add_rows([make_row(1000)])
        assert came[-1] == (clock.now_ns(), 1)

    run_virtual(main)


def test_many_rows_are_several_messages_one_after_the_other_and_the_end_does_not_wait() -> None:
    async def main(clock: VirtualClock) -> None:
        came: list[tuple[int, int]] = []
        feed = PointFeed(clock, lambda rows: came.append((clock.now_ns() // 1_000_000, len(rows))), store_nothing)
        feed.add_rows([make_row(point) for point in range(2200)])
        await asyncio.sleep(0.06)
        assert came == [(0, 500), (50, 500)]
        await feed.finish()
        assert [count for _, count in came] == [500, 500, 500, 500, 200] and came[-1][0] == 60

    run_virtual(main)


def test_every_message_is_within_its_budget_and_names_the_row_before_it() -> None:
    async def main(clock: VirtualClock) -> None:
        net, received = MemoryNet(clock), list[bytes]()
        keys = FleetKeys("lab")
        await net.join_process("reader").subscribe(keys.job_points(), lambda sample: received.append(sample.payload))
        publisher = PointPublisher(net.join_process("coordinator"), keys, "a1")
        publisher.publish_rows([make_row(point) for point in range(1, 501)])
        publisher.publish_rows([make_row(point, NAMES) for point in range(501, 1001)])
        await asyncio.sleep(1)
        assert len(received) > 2 and all(len(payload) <= POINT_BYTES for payload in received)
        # The usual ones, with where two axes were, have a third of it.
        assert len(received[0]) < POINT_BYTES / 2.5
        messages = [JobPoints.read_message(payload) for payload in received]
        assert [row.point for message in messages for row in message.rows] == list(range(1, 1001))
        assert [message.after_point for message in messages] == [0, *(m.rows[-1].point for m in messages[:-1])]
        assert [message.after_step for message in messages] == [-1] + [2] * (len(messages) - 1)

    run_virtual(main)


def test_rows_that_a_journal_does_not_take_stay_at_hand_and_are_written_with_the_next_ones() -> None:
    async def main(clock: VirtualClock) -> None:
        written: list[int] = []
        is_full = True

        async def store(rows: Sequence[PointRecord]) -> None:
            if is_full:
                raise JournalError("the disk is full")
            written.extend(row.point for row in rows)

        feed = PointFeed(clock, lambda _: None, store)
        feed.add_rows([make_row(1)])
        await feed.write_in_turn()  # neither many nor late
        await asyncio.sleep(1)
        with pytest.raises(JournalError):
            await feed.write_in_turn()
        feed.add_rows([make_row(2)])
        assert [row.point for row in feed.unwritten] == [1, 2]
        is_full = False
        await feed.finish()
        assert written == [1, 2] and feed.unwritten == []

    run_virtual(main)


def test_a_row_that_comes_while_others_are_written_stays() -> None:
    async def main(clock: VirtualClock) -> None:
        written: list[Any] = []

        async def store(rows: Sequence[PointRecord]) -> None:
            await asyncio.sleep(0.5)
            written.append([row.point for row in rows])

        feed = PointFeed(clock, lambda _: None, store)
        feed.add_rows([make_row(1)])
        writing = asyncio.ensure_future(feed.finish())
        await asyncio.sleep(0.1)
        feed.add_rows([make_row(2)])
        await writing
        assert [row.point for row in feed.unwritten] == [2] and written == [[1]]
        await feed.finish()
        assert written == [[1], [2]]

    run_virtual(main)
