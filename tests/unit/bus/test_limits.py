"""Limits of what a process takes from the bus and writes to its log."""

import json

from orchestrator.bus.base import Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.limits import MAX_BYTES_QUEUED, MAX_CALLS_QUEUED, MAX_ESTOPS_QUEUED
from orchestrator.bus.log import MAX_LINE_CHARS, MAX_LINES_PER_S, MAX_PUBLISHED_PER_S, ProcessLog
from orchestrator.bus.memory.bus import MemoryNet
from orchestrator.bus.zenoh.threads import _PriorityLanes  # pyright: ignore[reportPrivateUsage]
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.messages import EstopMessage, StopRequest


def test_a_flood_of_lines_is_cut_in_the_file_and_on_the_bus_and_counted() -> None:
    async def main(clock: VirtualClock) -> None:
        net, lines, published = MemoryNet(clock), list[str](), list[bytes]()
        keys = FleetKeys("lab")
        await net.join_process("reader").subscribe(keys.log(), lambda sample: published.append(sample.payload))
        log = ProcessLog("host", "cell", clock, lines.append, (net.join_process("host"), keys))
        other = ProcessLog("coordinator", "c", clock, lines.append)
        for _ in range(1000):
            log.warning("garbage")
        other.info("another source")
        assert len(lines) == MAX_LINES_PER_S + 1
        await sleep_ns(clock, 1100 * NS_PER_MS)
        assert len(published) == MAX_PUBLISHED_PER_S
        log.info("quiet again")
        log.info("and again")
        assert [json.loads(line).get("left_out_before") for line in lines[-2:]] == [1000 - MAX_LINES_PER_S, None]

    run_virtual(main)


def test_a_long_line_is_shortened_and_stays_json() -> None:
    async def main(clock: VirtualClock) -> None:
        lines = list[str]()
        log = ProcessLog("host", "cell", clock, lines.append)
        log.info("x" * 1_000_000)
        log.info("short", bytes="y" * 1_000_000)
        assert max(map(len, lines)) <= MAX_LINE_CHARS
        assert all("the line had 1000" in json.loads(line)["text"] for line in lines)

    run_virtual(main)


def test_queues_between_threads_hold_no_more_than_their_limits() -> None:
    lanes, made = _PriorityLanes("test", 10), list[int]()
    for number in range(12):
        lanes.add_call(Priority.STATE, lambda number=number: made.append(number), 5)
    assert len(lanes) == 10
    for _ in range(MAX_CALLS_QUEUED + 5):
        lanes.add_call(Priority.EVENT, lambda: made.append(-1))
    assert len(lanes) == 10 + MAX_CALLS_QUEUED
    lanes.discard_calls()
    lanes.add_call(Priority.EVENT, lambda: made.append(1), MAX_BYTES_QUEUED)
    lanes.add_call(Priority.EVENT, lambda: made.append(2), 1)
    for _ in range(MAX_ESTOPS_QUEUED + 5):
        lanes.add_call(Priority.ESTOP, lambda: made.append(0), 100)
    while call := lanes.take_call():
        call()
    # E-stops first, and of the rest what had place.
    assert made == [0] * MAX_ESTOPS_QUEUED + [1]
    lanes.add_call(Priority.EVENT, lambda: None, MAX_BYTES_QUEUED)
    assert len(lanes) == 1


def test_a_stop_with_a_long_reason_is_a_stop() -> None:
    estop = EstopMessage(event="e", actor="a" * 1000, reason="r" * 10_000)
    assert (len(estop.actor), len(estop.reason)) == (128, 500)
    assert len(StopRequest(request_id="1", actor="a", reason="r" * 10_000).reason) == 500
