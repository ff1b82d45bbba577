"""A server with 64 axes whose states come ten times a second; it writes the share of a core that it took."""

import asyncio
import sys
import time
from datetime import UTC, datetime
from typing import Any

from asyncua.server.server import Server

from integrations.opcua.axis_nodes import AxisNodes
from tutti import AxisState, StateReading

AXES, PER_CONTROLLER, HZ, SECONDS = 64, 4, 10, 20


def read(controller: int, number: int) -> StateReading:
    """A reading of a controller on the way: all its positions have changed."""
    position = number / 10
    state = AxisState(
        position=position,
        commanded=position,
        velocity=number % 7,
        motor_position=position,
        raw_counts=position * 1000,
        commanded_counts=number * 100,
        unit="mm",
        moving=True,
        enabled=True,
        referenced=True,
    )
    axes = {f"c{controller}.a{axis}": state for axis in range(PER_CONTROLLER)}
    return StateReading(f"c{controller}", "moving", axes, None, datetime.now(UTC).isoformat(), 0)


def tell(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


async def main(port: int) -> None:
    server: Any = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    nodes = AxisNodes(server, await server.register_namespace("urn:load"))
    controllers = range(AXES // PER_CONTROLLER)
    await nodes.build(server.nodes.objects, {axis: "mm" for c in controllers for axis in read(c, 0).axes})
    async with server:
        tell("ready")
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
        begin_s, begin_cpu_s = time.monotonic(), time.process_time()
        for number in range(HZ * SECONDS):
            for controller in controllers:
                await nodes.show(read(controller, number))
            await asyncio.sleep(max(0.0, begin_s + (number + 1) / HZ - time.monotonic()))
        tell(str((time.process_time() - begin_cpu_s) / (time.monotonic() - begin_s)))


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
