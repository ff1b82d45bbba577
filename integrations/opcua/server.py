"""A fleet as a server of OPC UA."""

import logging
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from asyncua.server.server import Server

from integrations.opcua.axis_nodes import AxisNodes, follow_axes
from integrations.opcua.fleet_nodes import FleetNodes
from integrations.opcua.job_nodes import JobNodes
from integrations.opcua.peers import TrustedPeers
from integrations.opcua.receiver import REFRESH_S, OrderReceiver
from integrations.opcua.types import ua
from integrations.opcua.work_masters import load_work_masters
from integrations.whole_fleet import refreshing
from tutti import Refusal, Tutti
from tutti.commands import ServerReady

NODESET = Path(__file__).parent / "nodesets" / "opc.ua.isa95-jobcontrol.nodeset2.xml"
ISA_NAMESPACE = "http://opcfoundation.org/UA/ISA95-JOBCONTROL_V2/"
MAX_SUBSCRIPTIONS = 200
MAX_CONNECTIONS = 100


@dataclass(frozen=True, slots=True)
class ServerSettings:
    """templates: the folder of the work masters. interface: an address of this computer. certificates: the folder that
    `tutti keys add-opcua` has made; None: nothing is signed or encrypted."""

    templates: Path
    interface: str = "127.0.0.1"
    port: int = 4840
    certificates: Path | None = None


@asynccontextmanager
async def serve_opcua(tutti: Tutti, settings: ServerSettings) -> AsyncGenerator[ServerReady]:
    """Serve the fleet while the context lasts. Raises `Refusal`."""
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what clients do wrong is answered to them
    logging.getLogger("asyncua.server.address_space").setLevel(logging.ERROR)  # what a method of ours did wrong
    receiver = OrderReceiver(tutti, load_work_masters(settings.templates))
    fleet = tutti.keys.fleet
    server: Any = await _make_server(settings, f"urn:tutti:{fleet}")
    own = await server.register_namespace(f"urn:tutti:{fleet}")
    isa = await server.get_namespace_index(ISA_NAMESPACE)
    root = await server.nodes.objects.add_object(own, fleet)
    axes, jobs = AxisNodes(server, own), JobNodes(server, receiver, own, isa)
    fleet_nodes = FleetNodes(server, tutti, receiver, own)
    await axes.build(root, {name: str(unit) for name, unit in (await tutti.list_names()).axes.items()})
    await jobs.build(root)
    await fleet_nodes.build(root)
    await receiver.restore()
    try:
        await server.start()
    except OSError as error:
        remedy = "choose another `--port`, or an address of this computer"
        raise Refusal("no-port", f"{settings.interface}:{settings.port} cannot be served: {error}", remedy) from None
    try:
        async with (
            refreshing(receiver.refresh, REFRESH_S),
            follow_axes(tutti, axes),
            refreshing(fleet_nodes.refresh, REFRESH_S),
        ):
            url = server.endpoint.geturl()
            lines = [f"OPC UA at {url}", f"work masters: {', '.join(receiver.templates)}"]
            yield ServerReady(lines, {"url": url, "work_masters": list(receiver.templates)})
    finally:
        await server.stop()


async def _make_server(settings: ServerSettings, uri: str) -> Any:
    peers = None if settings.certificates is None else TrustedPeers(settings.certificates)
    server: Any = Server(user_manager=peers)
    await server.init()
    await server.set_application_uri(uri)
    server.set_server_name("Tutti")
    server.set_endpoint(f"opc.tcp://{settings.interface}:{settings.port}/tutti/")
    server.set_identity_tokens([ua.AnonymousIdentityToken])
    if peers is None:
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    else:
        await peers.secure(server)
    internal = server.iserver
    internal.allow_remote_admin = False  # no user name gives rights to change the nodes
    internal.max_subscriptions, internal.max_connections = MAX_SUBSCRIPTIONS, MAX_CONNECTIONS
    await server.import_xml(str(NODESET))
    await server.load_data_type_definitions()
    return server
