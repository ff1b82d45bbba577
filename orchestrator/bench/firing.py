"""How late the last byte of a start is written, live: by the firing process, and by an event loop beside it.

The machine idle, and while an adapter host reads 16 simulated controllers on TCP and puts their states on the bus, ten
times a second each, beside the simulators' own processes.
"""

import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from random import Random
from typing import NamedTuple

from adapters.contract import Firer
from adapters.host.firing_process import ProcessFirer
from adapters.link.tcp import open_tcp
from adapters.toolkit.firing import LoopFirer
from orchestrator.bench.fleet import measured_fleet
from orchestrator.bench.spread import Spread, spread
from orchestrator.bench.sync_fleets import smc4000
from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.link.base import Link
from orchestrator.model.fleet import Fleet, TcpLink

CONTROLLERS = 16
HZ = 10.0
IDLE_MS, POLLING_MS = 0.05, 0.1
AHEAD_S = (0.02, 0.06)  # from the order to its instant, as between `go` and T0
LATE_NS = 1_000_000_000  # nothing is thrown away as too late: its lateness is the figure


class FiringFigures(NamedTuple):
    """Instant → the byte is written. loop_: by this process's event loop, as if there were no firing process."""

    idle: Spread
    polling: Spread
    loop_idle: Spread
    loop_polling: Spread


async def bench_firing(state: Path, shots: int) -> FiringFigures:
    """Fire `shots` bytes each way. Raises `UpFailed`, `Refused`, `NothingHappened`."""
    async with _open_link() as link:
        process = ProcessFirer()
        try:
            loop = LoopFirer(LiveClock())
            await _late_ns(process, link, 1)  # it has started
            idle, loop_idle = await _late_ns(process, link, shots), await _late_ns(loop, link, shots)
            async with measured_fleet(_fleet(), state):
                polling, loop_polling = await _late_ns(process, link, shots), await _late_ns(loop, link, shots)
        finally:
            process.close()
    return FiringFigures(
        spread(idle, p99_ms=IDLE_MS), spread(polling, p99_ms=POLLING_MS), spread(loop_idle), spread(loop_polling)
    )


def _fleet() -> Fleet:
    controllers = {
        f"a{k}": {**smc4000(k), "state": {"moving_hz": HZ, "idle_hz": HZ}, "inputs": {}} for k in range(CONTROLLERS)
    }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "firing", "controllers": controllers})


@asynccontextmanager
async def _open_link() -> AsyncGenerator[Link]:
    """A connection to somebody on this machine who never reads; the operating system takes the bytes."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = await open_tcp(TcpLink(host="127.0.0.1", port=server.getsockname()[1]), LiveClock())
        try:
            yield link
        finally:
            await link.close()


async def _late_ns(firer: Firer, link: Link, shots: int) -> list[int]:
    draw = Random(shots)
    late: list[int] = []
    for _ in range(shots):
        at_ns = raw_ns() + round(draw.uniform(*AHEAD_S) * 1e9)
        fired = await firer.schedule(link, b"\r", at_ns, at_ns + LATE_NS).done()
        late.append(fired.written_ns - at_ns)
    return late
