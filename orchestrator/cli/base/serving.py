"""Commands that serve a fleet to other clients until they are interrupted."""

import asyncio
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import Any

from orchestrator.cli.base.common import console, print_json
from orchestrator.cli.base.errors import run_main
from orchestrator.client import Tutti
from orchestrator.clock.signals import call_at_signals


@dataclass(frozen=True, slots=True)
class ServerReady:
    """What a server says once clients can use it. lines: for people; fields: for programs, besides the fleet's name."""

    lines: list[str]
    fields: dict[str, Any] = field(default_factory=dict[str, Any])


ServerStart = Callable[[Tutti], AbstractAsyncContextManager[ServerReady]]
"""Opens a server for a connected fleet; the server runs while the context lasts."""


def serve_fleet(connect: str, fleet: str | None, actor: str, start: ServerStart, *, as_json: bool) -> None:
    """Connect to a fleet and serve it until Ctrl-C or SIGTERM. actor: the server, in journals and logs. What the server
    has begun ends with it. Prints what `start` says when it is ready, as one JSON object with `as_json`."""

    async def serve() -> None:
        end_event = asyncio.Event()
        call_at_signals(end_event.set)
        async with Tutti(connect, fleet, actor=actor) as tutti, start(tutti) as ready:
            if as_json:
                print_json({"fleet": tutti.keys.fleet, **ready.fields})
            else:
                for line in [*ready.lines, "Ctrl-C ends it, and stops what it has begun"]:
                    console.print(line, highlight=False, markup=False, soft_wrap=True)
            await end_event.wait()

    run_main(serve())
