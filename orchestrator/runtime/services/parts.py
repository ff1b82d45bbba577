"""The parts of a fleet: one table for `tutti up`, for the units of systemd, and for the identities of both."""

from collections.abc import Sequence
from dataclasses import dataclass

from orchestrator.keys.names import Role


@dataclass(frozen=True, slots=True)
class FleetPart:
    """One part. module: of its process. role: of its certificate.

    watchdog_s: how long its service may make no progress. missing: what a fleet does not do while it is away; empty:
    without this part there is no fleet.
    """

    name: str
    module: str
    role: Role
    watchdog_s: int
    missing: str = ""

    def make_command(self, python: str, *options: str, switches: Sequence[str] = ()) -> list[str]:
        """The command of its process. switches: of the interpreter."""
        return [python, *switches, "-m", self.module, *options]


# The router's own check is a session each ten seconds, and three failures in turn.
ROUTER = FleetPart("router", "orchestrator.bus.zenoh.router", "router", 60)
COORDINATOR = FleetPart("coordinator", "orchestrator.coordinator.process", "coordinator", 20)
HOST = FleetPart("host", "adapters.host.guardian", "host", 5)
GATEWAY = FleetPart("gateway", "orchestrator.gateway.process", "gateway", 30, "the page is not served any more")
RECORDER = FleetPart(
    "recorder", "orchestrator.monitor.recording.process", "recorder", 30, "nothing is recorded any more"
)

PARTS = {part.name: part for part in (ROUTER, COORDINATOR, HOST, GATEWAY, RECORDER)}


def list_gateway_options(fleet: str, connect: str, state: str, log: str) -> list[str]:
    """The options that every gateway has. state: its folder."""
    return ["--fleet", fleet, "--connect", connect, "--state", state, "--log", log]


def list_certificate_options(certificate: str, key: str) -> list[str]:
    """The options of a gateway that serves the page by TLS. certificate, key: their files."""
    return ["--ssl-certfile", certificate, "--ssl-keyfile", key]


def list_recorder_options(fleet: str, file: str, connect: str, folder: str, quota: int) -> list[str]:
    """The options that every recorder has. file: of the fleet. folder: of the recordings. quota: their bytes."""
    options = ["--fleet", fleet, "--fleet-file", file, "--connect", connect, "--folder", folder]
    return [*options, "--quota", str(quota)]
