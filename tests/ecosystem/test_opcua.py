"""A client of OPC UA drives the demo fleet: asyncua's, against `tutti opcua serve` in a process of its own."""

import asyncio
import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.crypto.cert_gen import (
    dump_private_key_as_pem,
    generate_private_key,
    generate_self_signed_app_certificate,
)
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509 import GeneralName, UniformResourceIdentifier
from cryptography.x509.oid import ExtendedKeyUsageOID
from pages import read_blocks

from integrations.opcua.job_nodes import answer_refusal
from integrations.opcua.server import ServerSettings, serve_opcua
from orchestrator.keys.opcua import add_opcua
from orchestrator.runtime.live.fleet import find_free_port
from tutti import NotAllowed, Refusal, Tutti
from tutti.testing import LiveTestbed

ua_any: Any = ua
LIMIT_S = 30.0
NO_TEXTS = ua.Variant([], ua.VariantType.LocalizedText, is_array=True)
STATUS_EVENT = 1006  # ISA95JobOrderStatusEventType
ISA = "http://opcfoundation.org/UA/ISA95-JOBCONTROL_V2/"
PAGE = Path(__file__).parents[2] / "docs/how-to/serve-opcua.md"
TEMPLATES = {
    "shift.template.job.yaml": read_blocks(PAGE, "yaml")[0],
    "wait.job.yaml": """
schema: tutti.job/1
name: wait
steps:
"""
    + "  - {do: dwell, duration: 0.2 s}\n" * 300,
}


@dataclass(frozen=True, slots=True)
class Served:
    url: str
    templates: Path
    fleet: LiveTestbed
    process: subprocess.Popen[str]


def start_server(endpoint: str, templates: Path, port: int) -> subprocess.Popen[str]:
    """What the page starts, at another port and with its output for programs."""
    program, *arguments = shlex.split(read_blocks(PAGE, "console")[0].removeprefix("$ "))
    assert program == "tutti"
    command = [sys.executable, "-c", "from orchestrator.cli.entry import main; main()", *arguments]
    command += ["--connect", endpoint, "--port", str(port), "--json"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=templates.parent, env=environment)


def read_url(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return json.loads("".join(iter(process.stdout.readline, "}\n")) + "}")["url"]


@pytest.fixture(scope="module")
def served(demo_fleet: LiveTestbed, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("served") / "orders"
    folder.mkdir()
    for name, text in TEMPLATES.items():
        (folder / name).write_text(text)
    with start_server(demo_fleet.endpoint, folder, find_free_port()) as process:
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
        return await self.call(method, order_of(order_id, master, **values), [ua.LocalizedText("by the plant")])

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
        response, status = await self.call(
            "RequestJobResponseByJobOrderID", ua.Variant(order_id, ua.VariantType.String)
        )
        assert status == 1
        return response

    async def call_by_state(self, number: int) -> list[Any]:
        states = ua.Variant([ua_any.ISA95StateDataType(StateNumber=number)], ua.VariantType.ExtensionObject)
        responses, status = await self.call("RequestJobResponseByJobOrderState", states)
        assert status == 1
        return responses or []

    async def refusal(self) -> str:
        return await (await self.node("JobOrders", "LastRefusal")).read_value()


def order_of(order_id: str, master: str, **values: Any) -> Any:
    parameters = [ua_any.ISA95ParameterDataType(ID=name, Value=ua.Variant(value)) for name, value in values.items()]
    masters = [ua_any.ISA95WorkMasterDataType(ID=master)]
    return ua_any.ISA95JobOrderDataType(JobOrderID=order_id, WorkMasterID=masters, JobOrderParameters=parameters)


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
            assert data["Verdict"] in ("green", "amber")  # amber where this computer is late
            assert 0 < data["StartSkewAtMost"] < 0.01
            assert response.StartTime < response.EndTime
            assert await mes.act("Clear", "order 1") == 1
            assert "order 1" not in await mes.states()

    asyncio.run(check())


@pytest.mark.nightly
def test_the_client_of_the_page_orders_a_job(served: Served) -> None:
    (block,) = read_blocks(PAGE, "python")
    command = [sys.executable, "-c", block.replace("opc.tcp://127.0.0.1:4840/tutti/", served.url)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    assert "Verdict" in run.stdout and "StartSkewAtMost" in run.stdout


def test_orders_wait_until_they_are_started(served: Served) -> None:
    async def check() -> None:
        async with plant(served.url) as mes:
            events: asyncio.Queue[Any] = asyncio.Queue()
            subscription = await mes.client.create_subscription(50, Receiver(events))
            kind = mes.client.get_node(ua.NodeId(STATUS_EVENT, mes.isa))
            await subscription.subscribe_events(await mes.node("JobOrders"), kind)
            assert await mes.store("later", "shift", method="Store", way=1.0) == 1
            await mes.wait_for("later", "NotAllowedToStart", "Waiting")
            assert await mes.act("RevokeStart", "later") == 1 << 3
            assert "is NotAllowedToStart and cannot be revoked" in await mes.refusal()
            assert await mes.call("Update", order_of("later", "shift", way=3.0), NO_TEXTS) == 1
            assert await mes.act("Start", "later") == 1
            await mes.wait_for("later", "Ended", "Completed")
            states = [event.JobState[0].StateText.Text for event in await take(events, "Ended")]
            assert states == ["NotAllowedToStart", "NotAllowedToStart", "AllowedToStart", "Running", "Ended"]
            (found,) = await mes.call_by_state(5)
            assert found.JobOrderID == "later"
            assert await mes.call_by_state(4) == []
            shown = served.fleet.tutti.show_job(found.JobResponseID).job
            assert shown is not None and shown.parameters_used["way"] == "3 mm"
            assert await mes.act("Cancel", "later") == 1 << 3
            assert await mes.act("Clear", "later") == 1

    asyncio.run(check())


def test_a_running_order_is_paused_stopped_and_aborted(served: Served) -> None:
    async def check() -> None:
        async with plant(served.url) as mes:
            for order_id in ("first", "second", "third"):
                assert await mes.store(order_id, "wait") == 1
            await mes.wait_for("first", "Running")
            assert await mes.act("Clear", "first") == 1 << 3
            assert await mes.act("Pause", "first") == 1
            await mes.wait_for("first", "Interrupted", "Suspended")
            assert await mes.act("Resume", "first") == 1
            await mes.wait_for("first", "Running")
            assert await mes.act("Abort", "first") == 1
            await mes.wait_for("first", "Aborted")
            assert await mes.act("Stop", "second") == 1
            await mes.wait_for("second", "Ended", "Completed")
            assert await mes.act("Abort", "third") == 1
            await mes.wait_for("third", "Aborted")
            for order_id in ("first", "second", "third"):
                assert await mes.act("Clear", order_id) == 1

    asyncio.run(check())


def test_axes_have_values_of_the_controllers_instants(served: Served) -> None:
    async def check() -> None:
        async with plant(served.url) as mes:
            position = await mes.node("Axes", "gantry.x", "Position")

            async def is_read() -> bool:
                return (await position.read_data_value(raise_on_bad_status=False)).StatusCode.is_good()

            await wait_until(is_read)
            served.fleet.tutti.move({"gantry.x": 7.0})
            moved_utc = datetime.now(UTC)

            async def is_shown() -> bool:
                data = await position.read_data_value()
                return abs(data.Value.Value - 7) < 0.01 and data.SourceTimestamp > moved_utc - timedelta(seconds=2)

            await wait_until(is_shown)
            data = await position.read_data_value()
            assert abs(data.SourceTimestamp - datetime.now(UTC)) < timedelta(seconds=5)
            unit = await (await position.get_child("0:EngineeringUnits")).read_value()
            assert (unit.UnitId, unit.DisplayName.Text) == (5066068, "mm")
            assert await (await mes.node("Axes", "gantry.x", "Referenced")).read_value() is True
            assert await (await mes.node("Axes", "gantry.x", "Reason")).read_value() == ""
            with pytest.raises(ua.UaStatusCodeError):
                await position.write_value(0.0)
            with pytest.raises(ua.UaStatusCodeError):
                await (await mes.node("JobOrders", "LastRefusal")).write_value("")

    asyncio.run(check())


def test_an_estop_stops_what_runs_and_what_is_stored_waits(served: Served) -> None:
    async def check() -> None:
        async with plant(served.url) as mes:
            fleet = await mes.node("Fleet")
            assert await mes.store("cut off", "wait") == 1
            await mes.wait_for("cut off", "Running")
            assert await fleet.call_method(f"{mes.own}:EStop", "a guard is open") == [True, ""]
            assert await (await mes.node("Fleet", "State")).read_value() == "e-stop"
            await mes.wait_for("cut off", "Aborted")
            assert await mes.store("during", "shift") == 1
            await mes.wait_for("during", "AllowedToStart", "Waiting")
            data = {each.ID: each.Value.Value for each in (await mes.respond("during")).JobResponseData}
            assert data["Reason"]
            assert await fleet.call_method(f"{mes.own}:Reset") == [True, ""]
            assert await (await mes.node("Fleet", "EStopLatched")).read_value() is False
            assert "during" in await mes.states()
            assert await mes.act("Cancel", "during") == 1
            assert await mes.act("Clear", "cut off") == 1

    asyncio.run(check())
    asyncio.run(wait_until(lambda: recover(served.fleet)))


def test_wrong_calls_are_answered_and_the_server_goes_on(served: Served) -> None:
    async def check() -> None:
        async with plant(served.url) as mes:
            text = ua.Variant("order", ua.VariantType.String)
            for code, arguments in (
                (ua.StatusCodes.BadArgumentsMissing, ()),
                (ua.StatusCodes.BadArgumentsMissing, (order_of("a", "shift"),)),
                (ua.StatusCodes.BadTooManyArguments, (order_of("a", "shift"), NO_TEXTS, NO_TEXTS)),
                (ua.StatusCodes.BadInvalidArgument, (text, NO_TEXTS)),
                (ua.StatusCodes.BadInvalidArgument, (ua.Variant(7), NO_TEXTS)),
                (ua.StatusCodes.BadInvalidArgument, (ua_any.ISA95WorkMasterDataType(ID="shift"), NO_TEXTS)),
                (ua.StatusCodes.BadInvalidArgument, (order_of("a", "shift"), text)),
            ):
                with pytest.raises(ua.UaStatusCodeError) as caught:
                    await mes.call("Store", *arguments)
                assert caught.value.code == code
            with pytest.raises(ua.UaStatusCodeError):
                await mes.call("Start", order_of("a", "shift"), NO_TEXTS)
            invalid = 1 << 32
            for order_id, master, values, words in (
                ("a", "nonsense", {}, "the work master nonsense is unknown; name one of: shift, wait"),
                ("a", "shift", {"way": 100.0}, "way: found 100.0; must be at most 40 mm"),
                ("a", "shift", {"way": float("nan")}, "way: nan is out of range"),
                ("a", "shift", {"way": "5 deg"}, "way: "),
                ("a", "shift", {"hight": 1.0}, "the job file has no parameter hight"),
                ("", "shift", {}, "the JobOrderID is no name"),
                ("x" * 200, "shift", {}, "the JobOrderID is no name"),
            ):
                assert await mes.store(order_id, master, method="Store", **values) == invalid
                assert words in await mes.refusal()
            for method in ("Start", "RevokeStart", "Pause", "Resume", "Stop", "Abort", "Cancel", "Clear"):
                assert await mes.act(method, "unknown") == 1 << 1
            assert await mes.store("twice", "shift", method="Store") == 1
            assert await mes.store("twice", "shift") == invalid
            assert "there is a job order twice already" in await mes.refusal()
            for state in ([], [ua_any.ISA95StateDataType(StateNumber=1)] * 2):
                states = ua.Variant(state, ua.VariantType.ExtensionObject, is_array=True)
                assert await mes.call("RequestJobResponseByJobOrderState", states) == [[], invalid]
            assert await mes.act("Cancel", "twice") == 1
            assert not {"a", "twice"} & (await mes.states()).keys()
            at_rest = {state.mode for state in served.fleet.tutti.status().values()}
            assert at_rest == {"idle"}

    asyncio.run(check())


@pytest.mark.nightly
def test_ten_thousand_subscriptions_are_refused_behind_the_first(served: Served) -> None:
    async def check() -> None:
        async with plant(served.url) as mes:
            refused = 0
            for _ in range(10_000):
                try:
                    await mes.client.create_subscription(100_000, Receiver(asyncio.Queue()))
                except ua.UaStatusCodeError as error:
                    assert error.code == ua.StatusCodes.BadTooManySubscriptions
                    refused += 1
            assert refused >= 9_800
            assert isinstance(await mes.states(), dict)

    asyncio.run(check())


@pytest.mark.nightly
def test_orders_go_on_without_the_server_and_are_there_again(served: Served) -> None:
    async def order(url: str) -> None:
        async with plant(url) as mes:
            assert await mes.store("long", "wait") == 1
            await mes.wait_for("long", "Running")

    async def go_on(url: str) -> None:
        async with plant(url) as mes:
            await mes.wait_for("long", "Running")
            assert await mes.act("Abort", "long") == 1
            await mes.wait_for("long", "Aborted")
            assert await mes.act("Clear", "long") == 1

    port = find_free_port()
    with start_server(served.fleet.endpoint, served.templates, port) as process:
        asyncio.run(order(read_url(process)))
        process.kill()
    assert [entry.name for entry in served.fleet.tutti.list_jobs(state="running")] == ["wait"]
    with start_server(served.fleet.endpoint, served.templates, port) as process:
        asyncio.run(go_on(read_url(process)))
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0


@pytest.mark.nightly
def test_only_known_certificates_open_a_session(demo_fleet: LiveTestbed, served: Served, tmp_path: Path) -> None:
    """In this process, against the same fleet: which clients may connect."""
    made = add_opcua(tmp_path / "server", "demo", datetime.now(UTC), 1, ("127.0.0.1",))
    assert made > datetime.now(UTC)
    known, stranger = make_client_key(tmp_path, "known"), make_client_key(tmp_path, "stranger")
    (tmp_path / "server/trusted/known.der").write_bytes(known[0].read_bytes())
    settings = ServerSettings(served.templates, port=find_free_port(), certificates=tmp_path / "server")

    async def look(url: str, key: tuple[Path, Path] | None) -> bool:
        client = Client(url)
        client.application_uri = "urn:plant"
        if key is not None:
            server = tmp_path / "server/cert.der"
            await client.set_security(SecurityPolicyBasic256Sha256, *key, server_certificate=server)
        try:
            async with client:
                return await client.get_namespace_index("urn:tutti:demo") > 0
        except ua.UaError:
            return False

    async def check() -> None:
        async with Tutti(demo_fleet.endpoint, actor="opcua") as tutti, serve_opcua(tutti, settings) as ready:
            url = ready.fields["url"]
            assert [await look(url, key) for key in (None, stranger, known)] == [False, False, True]
            (tmp_path / "server/trusted/known.der").unlink()
            assert not await look(url, known)

    asyncio.run(check())


def make_client_key(folder: Path, name: str) -> tuple[Path, Path]:
    key = generate_private_key()
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
    names: list[GeneralName] = [UniformResourceIdentifier("urn:plant")]
    certificate = generate_self_signed_app_certificate(key, name, {"countryName": "DE"}, names, uses, 1)
    paths = folder / f"{name}.der", folder / f"{name}.pem"
    paths[0].write_bytes(certificate.public_bytes(Encoding.DER))
    paths[1].write_bytes(dump_private_key_as_pem(key))
    return paths


def test_a_right_that_the_server_lacks_is_an_access_denied() -> None:
    refused = NotAllowed("no-coordinator", "not allowed as viewer-anna.1: its role may not do `submit`")
    assert answer_refusal(refused) == ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
    (status,) = answer_refusal(Refusal("not-queued", "it runs"))
    assert (status.Value, status.VariantType) == (1 << 3, ua.VariantType.UInt64)


class Receiver:
    def __init__(self, events: "asyncio.Queue[Any]") -> None:
        self._events = events

    def event_notification(self, event: Any) -> None:
        self._events.put_nowait(event)


async def recover(fleet: LiveTestbed) -> bool:
    """Whether motors and queue could be started; the coordinator knows of a reset a moment later."""
    try:
        fleet.tutti.enable()
        fleet.tutti.start_queue()
    except Refusal:
        return False
    return True


async def take(events: "asyncio.Queue[Any]", last: str) -> list[Any]:
    """The events up to that with the state `last`."""
    taken: list[Any] = []
    async with asyncio.timeout(LIMIT_S):
        while not taken or taken[-1].JobState[0].StateText.Text != last:
            event = await events.get()
            if event.EventType.Identifier == STATUS_EVENT:
                taken.append(event)
    return taken
