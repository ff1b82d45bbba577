"""The gateway as a process of its own: `python -m orchestrator.gateway.process --help`.

Prints a line when it serves: the address of the page. Ends with SIGTERM or SIGINT, and with its parent. Exit codes: 2
bad input, or no port; 3 the bus cannot be reached.
"""

import argparse
import sys
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from secrets import token_urlsafe

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.identity import CERTIFICATE_FILE, find_identity
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.log import ProcessLog
from orchestrator.bus.logfile import make_file_sink
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.own_alarms import report_own_alarms
from orchestrator.bus.zenoh.service_process import BAD_INPUT, run_service
from orchestrator.client import Tutti
from orchestrator.clock.executor import CHECKING, ProcessExecutor, ThreadExecutor
from orchestrator.clock.live import LiveClock, prepare_live_process
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.service_manager import ServiceManager
from orchestrator.clock.signals import call_at_signals
from orchestrator.gateway.access.users import UserFile
from orchestrator.gateway.app import Gateway, GatewayOptions
from orchestrator.gateway.certificate import WebCertificate, read_web_certificate
from orchestrator.gateway.certificate_watch import CertificateWatch
from orchestrator.gateway.reach import is_own_address, list_names_beyond, require_reach
from orchestrator.gateway.server import ADDRESS, NotServed, make_server, open_port
from orchestrator.model.errors import Refusal
from orchestrator.model.operation.alarms import AlarmRequest
from orchestrator.runtime.state.folder import RECORDINGS, USERS_FILE


@dataclass(frozen=True, slots=True)
class GatewayPlace:
    """fleet: its name. connect: the router. state: the state folder. jobs: the folder of templates. port: None: the
    first free one. certificate, key: PEM files, for TLS. service: it is a service of its own."""

    fleet: str
    connect: str
    state: Path
    log: Path
    jobs: Path | None = None
    address: str = ADDRESS
    port: int | None = None
    certificate: Path | None = None
    key: Path | None = None
    service: bool = False


async def serve_gateway(place: GatewayPlace, on_ready: Callable[[str], None]) -> int:
    """Serve until the process is to end; return the exit code. on_ready: called with the address of the page.

    Raises `NotServed`, `RouterUnreachable`, `UnsafePath`, and `OSError` for the log.
    """
    certificate = _check_reach(place)
    context = None if certificate is None else certificate.make_context()
    names = () if certificate is None or is_own_address(place.address) else list_names_beyond(certificate)
    listener = open_port(place.address, place.port)
    port = listener.getsockname()[1]
    bus = await open_bus(place.connect)
    try:
        clock, keys = LiveClock(), FleetKeys(place.fleet)
        log = ProcessLog("gateway", place.fleet, clock, make_file_sink(place.log), (bus, keys))
        secure, execute, decode = context is not None, ThreadExecutor("gateway"), ProcessExecutor()
        check = ProcessExecutor(CHECKING)
        files = place.state / USERS_FILE, token_urlsafe, place.jobs, place.state / RECORDINGS
        options = GatewayOptions(port, *files, secure=secure, names=names, decode=decode, check=check)
        gateway = Gateway(Tutti(bus, place.fleet, "gateway"), clock, log, execute, options)
        server = make_server(gateway.app, context, log.warning)
        # The server has handlers of its own while it runs; the signal comes here afterwards.
        call_at_signals(lambda: None)
        await gateway.start()
        prepare_live_process()
        await bus.announce(keys.live("gateway", uuid.uuid4().hex[:8], "1"))
        host = f"[{place.address}]" if ":" in place.address else place.address
        address = f"{'https' if secure else 'http'}://{next(iter(names), host)}:{port}/"
        log.info(f"serves fleet {place.fleet} on {address}")
        on_ready(f"page on {address}")
        tasks_beside = TaskOwner()
        if place.service:
            tasks_beside.spawn(ServiceManager().run_alone())
        if certificate is not None and context is not None:
            raise_alarm = _make_alarm(bus, keys, place)
            watch = CertificateWatch(
                certificate=certificate,
                clock=clock,
                execute=execute,
                log=log,
                context=context,
                admit=gateway.guard.admit,
                raise_alarm=raise_alarm,
                beyond=bool(names),
            )
            tasks_beside.spawn(watch.run())
        try:
            async with report_own_alarms(bus, keys, ("gateway", "own"), place.connect):
                await server.serve([listener])
        finally:
            tasks_beside.cancel_all()
            decode.close()
            check.close()
            await gateway.close()
    finally:
        await bus.close()
    return 0


def _check_reach(place: GatewayPlace) -> WebCertificate | None:
    """The certificate of the page, if it has one. Raises `NotServed` if that, or the address, cannot be used."""
    try:
        certificate = None
        if place.certificate is not None:
            certificate = read_web_certificate(place.certificate, place.key or place.certificate)
        require_reach(place.address, certificate, UserFile(place.state / USERS_FILE), datetime.now(UTC))
    except Refusal as error:
        raise NotServed(f"{error.text}; {error.remedy}") from None
    return certificate


def _make_alarm(bus: Bus, keys: FleetKeys, place: GatewayPlace) -> Callable[[AlarmRequest], None]:
    """What publishes an alarm about the certificate. The identity's own one is announced by its session already."""
    identity = find_identity() if "tls/" in place.connect else None
    is_announced = identity is not None and identity / CERTIFICATE_FILE == place.certificate

    def raise_alarm(request: AlarmRequest) -> None:
        if not is_announced:
            bus.put(keys.alarm_request("gateway", "page"), request.to_json(), Priority.EVENT)

    return raise_alarm


def _print_ready(words: str) -> None:
    sys.stdout.write(f"{words}\n")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m orchestrator.gateway.process", description=__doc__)
    parser.add_argument("--fleet", required=True, help="the fleet's name")
    parser.add_argument("--connect", required=True, help="the router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--state", type=Path, required=True, help="the state folder, with users and recordings")
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--jobs", type=Path, default=None, help="the folder of job files that the page offers")
    parser.add_argument("--address", default=ADDRESS, help="beyond this computer only with a certificate and users")
    parser.add_argument("--port", type=int, default=None, help="default: the first free one of 8080 to 8089")
    parser.add_argument("--ssl-certfile", type=Path, default=None, help="PEM: serve by TLS")
    parser.add_argument("--ssl-keyfile", type=Path, default=None)
    parser.add_argument("--service", action="store_true", help="a service of its own: announce that it is ready")
    parser.add_argument("--parent", type=int, default=0, help="end when this process ends")
    given_args = parser.parse_args()
    gateway_place = GatewayPlace(
        fleet=given_args.fleet,
        connect=given_args.connect,
        state=given_args.state,
        log=given_args.log,
        jobs=given_args.jobs,
        address=given_args.address,
        port=given_args.port,
        certificate=given_args.ssl_certfile,
        key=given_args.ssl_keyfile,
        service=given_args.service,
    )
    if given_args.parent:
        die_with_parent(given_args.parent)
    return run_service(serve_gateway(gateway_place, _print_ready), gateway_place.log, {NotServed: BAD_INPUT})


if __name__ == "__main__":
    raise SystemExit(main())
