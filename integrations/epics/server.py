"""A fleet as an EPICS server of both protocols."""

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from integrations.epics.axes import open_axes
from integrations.epics.ca import serve_ca
from integrations.epics.channels import Channel, make_channels
from integrations.epics.fleet import FLEET_FIELDS, open_fleet_record
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
    async with open_axes(tutti) as axes, open_fleet_record(tutti) as fleet:
        records = {f"{prefix}{axis.record.axis.replace('.', ':')}": axis.record for axis in axes}
        channels = [channel for name, record in records.items() for channel in make_channels(record, name)]
        channels += [Channel((f"{prefix}{key}",), fleet, key, field) for key, field in FLEET_FIELDS.items()]
        address = settings.interface
        with serve_pva(channels, fleet, prefix, address, settings.pva_port) as pva_port:
            async with serve_ca(channels, address, settings.ca_port) as ca_port:
                ports = f"PVAccess at {address}:{pva_port}, Channel Access at {address}:{ca_port}"
                fields = {"records": list(records), "pva_port": pva_port, "ca_port": ca_port}
                yield ServerReady([f"motor records: {', '.join(records)}", ports], fields)
