"""Stop of a controller over a separate link, in place of a dead driver."""

import asyncio
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.link.base import LinkClosed, LinkRefused, OpenLink

TRY_NS = 2 * NS_PER_S
PAUSE_NS = 20 * NS_PER_MS

# How long to read after the last byte is sent. Replies are read before the link is closed: a socket that is closed with
# unread bytes resets the connection, and may discard the stop.
LISTEN_NS = 150 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class StopResult:
    """The stop was written at host time `written_ns`, at try number `tries`; `answer` arrived shortly after."""

    written_ns: int
    tries: int
    answer: bytes


async def send_last_stop(open_link: OpenLink, data: bytes, clock: Clock) -> StopResult:
    """Open a link, retrying for `TRY_NS`, and write `data`. Raises `LinkRefused` or `LinkClosed`: the last reason."""
    give_up_ns = clock.now_ns() + TRY_NS
    tries = 0
    while True:
        tries += 1
        try:
            return await send_stop_once(open_link, data, clock, tries)
        except (LinkRefused, LinkClosed):
            if clock.now_ns() >= give_up_ns:
                raise
        await sleep_ns(clock, PAUSE_NS)


async def send_stop_once(open_link: OpenLink, data: bytes, clock: Clock, tries: int = 1) -> StopResult:
    """Open a link, write `data`, listen for `LISTEN_NS`, and close the link. Raises `LinkRefused`, or `LinkClosed`
    without an answer."""
    link = await open_link()
    answer = b""
    try:
        written_ns = link.write(data)
        try:
            async with asyncio.timeout((len(data) * link.char_ns + LISTEN_NS) / NS_PER_S):
                while True:
                    answer += (await link.read()).data
        except TimeoutError:
            pass
        except LinkClosed:
            if not answer:  # else the stop has arrived, whatever became of the link
                raise
    finally:
        await link.close()
    return StopResult(written_ns, tries, answer)
