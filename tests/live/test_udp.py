"""An SMC-4000 over UDP: our link and the simulator's port, with real datagrams."""

import asyncio

import pytest
from children import LIMIT_S, Children

from adapters.link.open import make_link_opener
from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.links import UdpLink

pytestmark = pytest.mark.live


async def ask(link: Link, command: bytes) -> str:
    link.write(command)
    answer = b""
    async with asyncio.timeout(LIMIT_S):
        while not answer.endswith((b":", b"?")):
            received = await link.read()
            assert 0 <= raw_ns() - received.at_ns < LIMIT_S * 1e9
            answer += received.data
    return answer.decode()


def test_handles_are_addresses_and_freed_by_clients_that_leave(children: Children) -> None:
    _, place = children.simulator("smc4000", "udp:127.0.0.1:0")

    async def main() -> None:
        opened = make_link_opener(UdpLink(kind="udp", host=place["host"], port=place["port"]), LiveClock())
        first = await opened()
        assert "0000000042.0000" in await ask(first, b"MG 6*7\r")
        free = set[str]()
        for _ in range(12):  # more than there are handles
            other = await opened()
            free.add(await ask(other, b"MG _IA2\r"))
            other.write(b"IHS=>-2\r")
            await other.close()
        assert len(free) == 1, free
        assert "IHA" in await ask(first, b"WH\r")
        await first.close()
        with pytest.raises(LinkClosed):
            first.write(b"MG 1\r")

    asyncio.run(main())
