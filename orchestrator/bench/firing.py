"""The delay of a start command's last byte, live: written by the firing process, and by an event loop for
comparison.

On an idle machine, and while an adapter host polls 16 simulated controllers on TCP and publishes their states, ten
times a second each, together with the simulators' own processes.
"""

import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from random import Random
from typing import NamedTuple

from adapters.contract import TimedWriter
from adapters.host.timed_writer import ProcessTimedWriter
from adapters.link.tcp import open_tcp
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.bench.fleet import run_measured_fleet
from orchestrator.bench.spread import DurationSpread, make_spread
from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.link.base import Link
from orchestrator.model.fleet import Fleet
from orchestrator.model.links import TcpLink
from orchestrator.runtime.simulated_fleets import make_smc4000

CONTROLLERS = 16
HZ = 10.0
IDLE_MS, POLLING_MS = 0.05, 0.1
LEAD_S = (0.02, 0.06)  # from the request to its instant, as between `go` and T0
MAX_DELAY_NS = 1_000_000_000  # no write is discarded as too late: its delay is the figure


class FiringFigures(NamedTuple):
    """Time from the scheduled instant to the write. loop_: by this process's event loop, without a firing process."""

    idle: DurationSpread
    polling: DurationSpread
    loop_idle: DurationSpread
    loop_polling: DurationSpread


async def bench_firing(state: Path, shots: int) -> FiringFigures:
    """Write `shots` bytes each way. Raises `UpFailed`, `Refusal`, `NothingHappened`."""
    async with _open_link() as link:
        process = ProcessTimedWriter()
        try:
            loop = LoopTimedWriter(LiveClock())
            await _measure_delays_ns(process, link, 1)  # it has started
            idle, loop_idle = (
                await _measure_delays_ns(process, link, shots),
                await _measure_delays_ns(loop, link, shots),
            )
            async with run_measured_fleet(_make_fleet(), state):
                polling, loop_polling = (
                    await _measure_delays_ns(process, link, shots),
                    await _measure_delays_ns(loop, link, shots),
                )
        finally:
            process.close()
    return FiringFigures(
        make_spread(idle, p99_ms=IDLE_MS),
        make_spread(polling, p99_ms=POLLING_MS),
        make_spread(loop_idle),
        make_spread(loop_polling),
    )


def _make_fleet() -> Fleet:
    controllers = {
        f"a{k}": {**make_smc4000(k), "state": {"moving_hz": HZ, "idle_hz": HZ}, "inputs": {}}
        for k in range(CONTROLLERS)
    }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "firing", "controllers": controllers})


@asynccontextmanager
async def _open_link() -> AsyncGenerator[Link]:
    """Open a connection to a local socket that is never read; the operating system buffers the bytes."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = await open_tcp(TcpLink(host="127.0.0.1", port=server.getsockname()[1]), LiveClock())
        try:
            yield link
        finally:
            await link.close()


async def _measure_delays_ns(firer: TimedWriter, link: Link, shots: int) -> list[int]:
    draw = Random(shots)
    late: list[int] = []
    for _ in range(shots):
        at_ns = raw_ns() + round(draw.uniform(*LEAD_S) * 1e9)
        write = await firer.schedule_write(link, b"\r", at_ns, at_ns + MAX_DELAY_NS).wait_until_written()
        late.append(write.written_ns - at_ns)
    return late
