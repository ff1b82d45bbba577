"""Which connection gives way to a new one, and how slowly a body may come; in virtual time."""

import asyncio
from collections.abc import Iterable

import pytest
from starlette.types import Message

from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.gateway.bodies import (
    BODY_S,
    LONGEST_BODY_S,
    MAX_BODIES_BYTES,
    MAX_BODY_BYTES,
    MAX_UNPROVEN_BYTES,
    BodyReader,
)
from orchestrator.gateway.connections import (
    GRACE_S,
    MAX_CONNECTIONS,
    MAX_NOT_SIGNED_IN,
    STOP_RESERVE,
    Connection,
    ConnectionTable,
)
from orchestrator.gateway.replies import RefusedRequest

LATE_S = 10 * GRACE_S


class Links:
    """A table with connections, by their numbers."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.table = ConnectionTable(self.lines.append)
        self.ended: list[int] = []
        self.made: list[Connection] = []

    def add(
        self, address: str = "192.0.2.1", *, now_s: float = LATE_S, begun_s: float = 0.0, signed_in: bool = False
    ) -> Connection:
        number = len(self.made)
        connection = Connection(
            address, begun_s + number * 1e-6, lambda: self.ended.append(number), signed_in=signed_in
        )
        self.made.append(connection)
        self.table.add_connection(connection, now_s)
        return connection


def test_of_an_address_the_oldest_that_is_not_signed_in_gives_way() -> None:
    links = Links()
    links.add(signed_in=True)
    links.add().working = True
    for _ in range(MAX_NOT_SIGNED_IN + 1):
        links.add()
    assert links.ended == [2, 3]
    links.add("192.0.2.2")
    assert links.ended == [2, 3]
    assert links.lines == [
        "1 connections ended for new ones, 1 of them of 192.0.2.1: an address has at most 20 that are not signed in"
    ]


def test_a_new_connection_has_time_for_its_request_before_it_gives_way() -> None:
    links = Links()
    for _ in range(2 * MAX_NOT_SIGNED_IN):
        links.add(now_s=GRACE_S / 2)
    assert links.ended == []
    links.table.make_room(LATE_S)
    assert links.ended == list(range(MAX_NOT_SIGNED_IN))


def test_what_waits_for_its_client_gives_way_before_what_is_at_work() -> None:
    links = Links()
    for number in range(MAX_CONNECTIONS):
        connection = links.add(f"192.0.2.{number}", signed_in=True)
        connection.working, connection.reading = number < 290, 290 <= number < 295
    for number in range(12):
        links.add("198.51.100.1", begun_s=LATE_S, signed_in=True).working = True
        assert len(links.table.connections) == min(MAX_CONNECTIONS, 300) + max(0, number - 9)
    assert links.ended == [*range(295, 300), *range(290, 295)]
    assert [connection.beyond for connection in links.made[-3:]] == [False, True, True]


def test_one_that_has_ended_is_not_counted() -> None:
    links = Links()
    for connection in [links.add() for _ in range(MAX_NOT_SIGNED_IN)]:
        links.table.remove_connection(connection)
        links.table.remove_connection(connection)
    links.add()
    assert links.ended == [] and len(links.table.connections) == 1


def test_beyond_the_reserve_none_has_a_time_of_grace() -> None:
    links = Links()
    for number in range(MAX_CONNECTIONS + 2 * STOP_RESERVE):
        links.add(f"192.0.2.{number}", now_s=0.0)
    assert len(links.table.connections) == MAX_CONNECTIONS + STOP_RESERVE
    links.table.make_room(LATE_S)
    assert len(links.table.connections) == MAX_CONNECTIONS


# Bodies


async def receive_all(parts: Iterable[tuple[float, int]], *, signed_in: bool, reader: BodyReader | None = None) -> int:
    """Receive parts, each after a time in s; return their bytes. The last part is the end of the body."""
    waiting = list(parts)

    async def receive() -> Message:
        wait_s, count = waiting[0]
        await asyncio.sleep(wait_s)
        del waiting[0]
        return {"type": "http.request", "body": b"x" * count, "more_body": bool(waiting)}

    size = 0
    async with (reader or BodyReader()).read_body(receive, signed_in=signed_in) as receive_limited:
        while True:
            message = await receive_limited()
            size += len(message["body"])
            if not message["more_body"]:
                return size


def refuse(parts: Iterable[tuple[float, int]], *, signed_in: bool) -> tuple[int, float]:
    """The status of the refusal of a body, and after how many s it came."""

    async def main(clock: VirtualClock) -> tuple[int, float]:
        with pytest.raises(RefusedRequest) as refused:
            await receive_all(parts, signed_in=signed_in)
        assert refused.value.refusal.remedy
        return refused.value.status, round(clock.now_ns() / 1e9, 1)

    return run_virtual(main)


def take(parts: Iterable[tuple[float, int]], *, signed_in: bool) -> int:
    return run_virtual(lambda _: receive_all(parts, signed_in=signed_in))


def test_a_body_that_is_not_signed_in_has_5_s_and_2_kb() -> None:
    assert take([(BODY_S - 1, 100), (0.9, 100)], signed_in=False) == 200
    assert refuse([(1, 1)] * 20, signed_in=False) == (408, BODY_S)
    assert refuse([(0, MAX_UNPROVEN_BYTES + 1)], signed_in=False) == (413, 0)


def test_a_body_that_is_signed_in_keeps_a_pace() -> None:
    assert refuse([(100, 1)], signed_in=True) == (408, BODY_S)
    assert take([(BODY_S - 0.1, 1), (0.9, 1)], signed_in=True) == 2
    assert take([(0.3, 4_000)] * 100, signed_in=True) == 400_000
    # 5 kB a second: too slow after the first one.
    assert refuse([(0.5, 2_500)] * 100, signed_in=True) == (408, 1.5)
    assert refuse([(0, 300_000), (3, 1)], signed_in=True) == (408, 2.0)
    assert refuse([(0.9, 11_000)] * 200, signed_in=True)[1] == pytest.approx(LONGEST_BODY_S, abs=1.0)
    assert refuse([(0, MAX_BODY_BYTES), (0, 1)], signed_in=True) == (413, 0)


def test_all_bodies_together_are_limited_while_they_are_at_work() -> None:
    async def main(_: VirtualClock) -> None:
        reader, count = BodyReader(), MAX_BODIES_BYTES // MAX_BODY_BYTES
        parts = [(0.0, MAX_BODY_BYTES - 10_000), (0.5, 10_000)]
        works = [receive_all(parts, signed_in=True, reader=reader) for _ in range(count + 1)]
        results = await asyncio.gather(*works, return_exceptions=True)
        statuses = [result.status for result in results if isinstance(result, RefusedRequest)]
        assert statuses == [503]
        # What has ended counts no more.
        assert await receive_all(parts, signed_in=True, reader=reader) == MAX_BODY_BYTES

    run_virtual(main)
