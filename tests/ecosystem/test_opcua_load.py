"""How much of a core a server of OPC UA takes for many axes."""

import asyncio
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from ecosystem.opcua_load import AXES, HZ, SECONDS

from orchestrator.runtime.live.fleet import find_free_port

MOST = 0.10  # of a core


class Counter:
    def __init__(self) -> None:
        self.count = 0

    def datachange_notification(self, *_: Any) -> None:
        self.count += 1


@pytest.mark.nightly
def test_64_axes_ten_times_a_second_take_a_tenth_of_a_core() -> None:
    port = find_free_port()
    command = [sys.executable, str(Path(__file__).with_name("opcua_load.py")), str(port)]

    async def follow(process: subprocess.Popen[str], counter: Counter) -> float:
        assert process.stdin is not None and process.stdout is not None
        async with Client(f"opc.tcp://127.0.0.1:{port}/") as client:
            own = await client.get_namespace_index("urn:load")
            folder = await client.nodes.objects.get_child(f"{own}:Axes")
            variables = [
                await axis.get_child(f"{own}:{name}")
                for axis in await folder.get_children()
                for name in ("Position", "Velocity")
            ]
            assert len(variables) == 2 * AXES
            subscription = await client.create_subscription(100, counter)
            await subscription.subscribe_data_change(variables, monitoring=ua.MonitoringMode.Reporting)
            process.stdin.write("go\n")
            process.stdin.flush()
            return float(await asyncio.to_thread(process.stdout.readline))

    counter = Counter()
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        share = asyncio.run(follow(process, counter))
    assert counter.count > 0.9 * 2 * AXES * HZ * SECONDS
    assert share <= MOST, f"{share:.1%} of a core"
