"""`tutti epics serve`: a fleet for clients of EPICS."""

import click

from tutti.commands import (
    BAD_INPUT,
    exit_with_error,
    fleet_options,
    interface_option,
    is_loopback,
    json_option,
    require_extra,
)

OPEN = (
    "PVAccess and Channel Access have no users here: each client that reaches this server moves the fleet with its "
    "rights. Put a gateway with access rules before it, such as p4p's `pvagw`, and keep this server on loopback"
)


@click.group(epilog="Example: tutti epics serve --prefix LAB:")
def epics() -> None:
    """Serve a fleet to clients of EPICS."""


@epics.command(epilog="Example: tutti epics serve --connect tcp/127.0.0.1:7447 --prefix LAB:")
@fleet_options
@json_option
@click.option("--prefix", help="What the names of all PVs begin with; the name of the fleet and a colon if left out.")
@interface_option
@click.option("--i-know", is_flag=True, help="Serve at an address beyond loopback.")
@click.option(
    "--pva-port", default=5075, show_default=True, help="Of PVAccess, TCP; its searches use the next one, UDP."
)
@click.option("--ca-port", default=5064, show_default=True, help="Of Channel Access, TCP and UDP.")
def serve(  # noqa: PLR0913
    connect: str,
    fleet: str | None,
    prefix: str | None,
    interface: str,
    pva_port: int,
    ca_port: int,
    *,
    i_know: bool,
    as_json: bool,
) -> None:
    """Serve each axis as a motor record by PVAccess and Channel Access, until Ctrl-C.

    What clients do, it does with its own rights: those of its identity's role. A move ends with this server.
    """
    if not is_loopback(interface) and not i_know:
        exit_with_error(f"--interface {interface}: {OPEN}", BAD_INPUT, "give --i-know if that is so")
    require_extra("epics", "p4p", "caproto")
    from integrations.epics.server import ServerSettings, serve_epics
    from tutti.commands import serve_fleet

    settings = ServerSettings(prefix, interface, pva_port, ca_port)
    serve_fleet(connect, fleet, "epics", lambda tutti: serve_epics(tutti, settings), as_json=as_json)
