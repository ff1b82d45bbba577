"""`tutti opcua serve`: a fleet for clients of OPC UA."""

from pathlib import Path

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


@click.group(epilog="Example: tutti opcua serve --templates orders")
def opcua() -> None:
    """Serve a fleet to clients of OPC UA."""


@opcua.command(epilog="Example: tutti opcua serve --templates orders")
@fleet_options
@json_option
@click.option(
    "--templates",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    required=True,
    help="The folder of the job files, each a work master.",
)
@interface_option
@click.option("--port", default=4840, show_default=True, type=click.IntRange(1, 65535), help="Of OPC UA, TCP.")
@click.option(
    "--certificates",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="The folder that `tutti keys add-opcua` has made; needed beyond loopback.",
)
def serve(  # noqa: PLR0913
    connect: str,
    fleet: str | None,
    templates: Path,
    interface: str,
    port: int,
    certificates: Path | None,
    *,
    as_json: bool,
) -> None:
    """Serve job orders (OPC 10031-4), axes and e-stop, until Ctrl-C.

    What clients do, it does with its own rights: those of its identity's role. Jobs that it has submitted go on without
    it.
    """
    if not is_loopback(interface) and certificates is None:
        text = f"--interface {interface}: without certificates every client that reaches it moves the fleet"
        exit_with_error(text, BAD_INPUT, "make them: `tutti keys add-opcua`; give --certificates")
    require_extra("opcua", "asyncua")
    from integrations.opcua.server import ServerSettings, serve_opcua
    from tutti.commands import serve_fleet

    settings = ServerSettings(templates, interface, port, certificates)
    serve_fleet(connect, fleet, "opcua", lambda tutti: serve_opcua(tutti, settings), as_json=as_json)
