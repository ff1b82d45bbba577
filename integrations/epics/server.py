"""A fleet as an EPICS server of both protocols."""

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from integrations.epics.axes import open_axes
from integrations.epics.ca import serve_ca
from integrations.epics.channels import make_channels
from integrations.epics.pva import serve_pva
from tutti import Tutti
from tutti.commands import ServerReady


@dataclass(frozen=True, slots=True)
class ServerSettings:
    """prefix: of all names; None: that of the fleet. interface: an address of this computer. Ports: 0 for any."""

    prefix: str | None = None
    interface: str = "127.0.0.1"
    pva_port: int = 5075
    ca_port: int = 5064


@asynccontextmanager
async def serve_epics(tutti: Tutti, settings: ServerSettings) -> AsyncGenerator[ServerReady]:
    """Serve the fleet while the context lasts. Raises `Refusal`."""
    prefix = f"{tutti.keys.fleet}:" if settings.prefix is None else settings.prefix
    async with open_axes(tutti) as axes:
        records = [(axis.record, f"{prefix}{axis.record.axis.replace('.', ':')}") for axis in axes]
        channels = [channel for record, name in records for channel in make_channels(record, name)]
        with serve_pva(channels, {}, settings.interface, settings.pva_port, settings.pva_port + 1) as pva_port:
            async with serve_ca(channels, settings.interface, settings.ca_port) as ca_port:
                names = [name for _, name in records]
                ports = f"PVAccess at {settings.interface}:{pva_port}, Channel Access at {settings.interface}:{ca_port}"
                fields = {"records": names, "pva_port": pva_port, "ca_port": ca_port}
                yield ServerReady([f"motor records: {', '.join(names)}", ports], fields)
