"""A request that arrives twice is executed once; its id with another content, or of another sender, is another one."""

import asyncio

import pytest

from orchestrator.bus.answers import MAX_ANSWERS, AnswerCache
from orchestrator.bus.base import RequestRefused
from orchestrator.model.messages import Request


class Server:
    """Counts what is executed."""

    def __init__(self) -> None:
        self.cache, self.count = AnswerCache(), 0

    async def ask(self, verb: str, actor: str, payload: bytes, request_id: str = "1") -> bytes:
        async def work() -> bytes:
            self.count += 1
            number = self.count
            await asyncio.sleep(0)
            return b"%d" % number

        return await self.cache.answer_once(verb, Request(request_id=request_id, actor=actor), payload, work)


def test_a_repeated_request_is_executed_once_also_while_it_runs() -> None:
    async def main() -> None:
        server = Server()
        assert await asyncio.gather(*(server.ask("cancel", "anna", b"a") for _ in range(3))) == [b"1"] * 3
        assert await server.ask("cancel", "anna", b"a") == b"1"
        assert await server.ask("cancel", "ben", b"a") == b"2"
        assert await server.ask("hold", "anna", b"b") == b"3"

    asyncio.run(main())


def test_an_id_that_was_used_for_another_request_is_refused_but_for_stops() -> None:
    async def main() -> None:
        server = Server()
        await server.ask("cancel", "anna", b"a")
        with pytest.raises(
            RequestRefused, match="key-used: the request id '1' was used by anna for another cancel; use"
        ):
            await server.ask("cancel", "anna", b"b")
        assert await server.ask("cancel", "anna", b"a") == b"1"
        for number, verb in enumerate(("stop", "latch")):
            answers = [await server.ask(verb, "anna", payload) for payload in (b"a", b"b", b"b", b"a")]
            first = 2 + 3 * number
            assert answers == [b"%d" % (first + more) for more in (0, 1, 1, 2)]

    asyncio.run(main())


def test_the_oldest_answer_is_forgotten() -> None:
    async def main() -> None:
        server = Server()
        for number in range(MAX_ANSWERS + 1):
            await server.ask("cancel", "anna", b"a", str(number))
        assert await server.ask("cancel", "anna", b"b", "0") == b"%d" % (MAX_ANSWERS + 2)

    asyncio.run(main())
