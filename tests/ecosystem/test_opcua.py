"""A client of OPC UA drives the demo fleet: asyncua's, against `tutti opcua serve` in a process of its own."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from socket import AF_INET, SOCK_STREAM, socket
from typing import Any

import pytest
from asyncua import Client, ua

from tutti.testing import LiveTestbed

ua_any: Any = ua
LIMIT_S = 30.0
ISA = "http://opcfoundation.org/UA/ISA95-JOBCONTROL_V2/"
TEMPLATES = {
    "shift.template.job.yaml": """
schema: tutti.job/1
name: shift
parameters:
  way: {type: quantity, unit: mm, default: 1 mm, min: 0.1 mm, max: 40 mm}
steps:
  - {do: move, by: {gantry.x: "${way}", stage.u: "0.1 mm"}}
  - {do: move, by: {gantry.x: "-${way}", stage.u: "-0.1 mm"}}
""",
    "wait.job.yaml": """
schema: tutti.job/1
name: wait
steps:
  - {do: dwell, duration: 1 s}
  - {do: dwell, duration: 60 s}
""",
}


@dataclass(frozen=True, slots=True)
class Served:
    url: str
    templates: Path
    fleet: LiveTestbed
    process: subprocess.Popen[str]


def free_port() -> int:
    with socket(AF_INET, SOCK_STREAM) as open_socket:
        open_socket.bind(("127.0.0.1", 0))
        return open_socket.getsockname()[1]


def start_server(endpoint: str, templates: Path, port: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", "from orchestrator.cli.entry import main; main()", "opcua", "serve", "--connect", endpoint]
    command += ["--templates", str(templates), "--port", str(port), "--json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def read_url(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return json.loads("".join(iter(process.stdout.readline, "}\n")) + "}")["url"]


@pytest.fixture(scope="module")
def served(demo_fleet: LiveTestbed, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("templates")
    for name, text in TEMPLATES.items():
        (folder / name).write_text(text)
    with start_server(demo_fleet.endpoint, folder, free_port()) as process:
        try:
            yield Served(read_url(process), folder, demo_fleet, process)
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0


class Plant:
    """A client, as a manufacturing execution system has it."""

    def __init__(self, client: Client, own: int, isa: int, root: Any) -> None:
        self.client, self.own, self.isa, self.root = client, own, isa, root

    async def node(self, *names: str) -> Any:
        return await self.root.get_child([f"{self.own}:{name}" for name in names])

    async def call(self, method: str, *arguments: Any) -> Any:
        kind = "JobResponses" if method.startswith("Request") else "JobOrders"
        return await (await self.node(kind)).call_method(f"{self.isa}:{method}", *arguments)

    async def store(self, order_id: str, master: str, *, method: str = "StoreAndStart", **values: Any) -> int:
        parameters = [ua_any.ISA95ParameterDataType(ID=k, Value=ua.Variant(v)) for k, v in values.items()]
        masters = [ua_any.ISA95WorkMasterDataType(ID=master)]
        order = ua_any.ISA95JobOrderDataType(JobOrderID=order_id, WorkMasterID=masters, JobOrderParameters=parameters)
        return await self.call(method, order, [ua.LocalizedText("by the plant")])

    async def act(self, method: str, order_id: str) -> int:
        return await self.call(method, ua.Variant(order_id, ua.VariantType.String), [ua.LocalizedText("why")])

    async def states(self) -> dict[str, list[str]]:
        orders = await (await self.node("JobOrders")).get_child(f"{self.isa}:JobOrderList")
        entries = await orders.read_value() or []
        return {entry.JobOrder.JobOrderID: [state.StateText.Text for state in entry.State] for entry in entries}

    async def wait_for(self, order_id: str, *texts: str) -> None:
        async def is_reached() -> bool:
            return (await self.states()).get(order_id) == list(texts)

        await wait_until(is_reached)

    async def respond(self, order_id: str) -> Any:
        response, status = await self.call("RequestJobResponseByJobOrderID", ua.Variant(order_id, ua.VariantType.String))
        assert status == 1
        return response

    async def refusal(self) -> str:
        return await (await self.node("JobOrders", "LastRefusal")).read_value()


async def wait_until(condition: Callable[[], Awaitable[bool]]) -> None:
    async with asyncio.timeout(LIMIT_S):
        while not await condition():
            await asyncio.sleep(0.02)


@asynccontextmanager
async def plant(url: str) -> AsyncGenerator[Plant]:
    async with Client(url) as client:
        await client.load_data_type_definitions()
        own, isa = await client.get_namespace_index("urn:tutti:demo"), await client.get_namespace_index(ISA)
        yield Plant(client, own, isa, await client.nodes.objects.get_child(f"{own}:demo"))


def test_an_order_moves_the_fleet(served: Served) -> None:
    async def check() -> None:
        async with plant(served.url) as mes:
            assert await mes.store("order 1", "shift", way=2.0) == 1
            await mes.wait_for("order 1", "Ended", "Completed")
            response = await mes.respond("order 1")
            data = {each.ID: each.Value.Value for each in response.JobResponseData}
            assert data["Verdict"] == "green"
            assert 0 < data["StartSkewAtMost"] < 0.01
            assert response.StartTime < response.EndTime
            assert await mes.act("Clear", "order 1") == 1
            assert "order 1" not in await mes.states()

    asyncio.run(check())
