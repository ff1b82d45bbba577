"""`tutti router`: the router of a fleet, by itself."""

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import (
    check_endpoint_option,
    console,
    keys_folder_option,
    print_json,
    state_option,
)
from orchestrator.cli.base.errors import errors, expected_errors, run_main
from orchestrator.cli.base.systems import require_linux
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.signals import call_at_signals

if TYPE_CHECKING:
    from orchestrator.runtime.services.router import RouterPlace

PROBE_S = 10.0  # between two sessions that show that it serves new ones


@click.command(
    epilog="""\b
Examples:
  tutti router lab.fleet.yaml --keys keys --listen tls/0.0.0.0:7447
  tutti router lab.fleet.yaml --keys keys --print-config > zenohd.json5

\b
Exit codes: 0 ended by Ctrl-C or SIGTERM; 2 bad input; 3 it cannot listen."""
)
@click.argument("file", required=False, default=None, type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option(
    "--listen",
    default="tcp/127.0.0.1:7447",
    show_default=True,
    callback=check_endpoint_option,
    help="Where it listens: `tls/HOST:PORT`, `tcp/…`, `unixsock-stream/PATH`; several with commas.",
)
@keys_folder_option("The folder of the fleet's keys, or that of this router.")
@click.option(
    "--link",
    "links",
    default="",
    callback=check_endpoint_option,
    help="The other routers of the fleet, with commas: all of them carry for each other.",
)
@click.option("--print-config", is_flag=True, help="Print the same configuration for `zenohd`, and end.")
@click.option("--insecure", is_flag=True, help="Listen to a network without TLS: everything there can move the fleet.")
@state_option
def router(
    file: Path | None,
    listen: str,
    keys: Path | None,
    state: Path | None,
    links: str,
    *,
    print_config: bool,
    insecure: bool,
) -> None:
    """Run the router of the fleet in FILE, and nothing else, until Ctrl-C.

    With --keys it listens with TLS, demands a certificate of the fleet's authority from each session, and allows each
    name what its role may do. A change of the keys, or of FILE, counts when the fleet is at rest.
    """
    from orchestrator.bus.endpoint import describe_openness
    from orchestrator.bus.zenoh.router import prepare_router_process
    from orchestrator.bus.zenoh.sessions import make_router_settings
    from orchestrator.keys.router_settings import nest_settings
    from orchestrator.runtime.services.router import RouterPlace, load_security
    from orchestrator.runtime.state.folder import default_state

    router_place = RouterPlace(listen=listen, keys=keys, fleet_file=file, state=state, links=links, insecure=insecure)
    with expected_errors():
        security = load_security(router_place)
    if print_config:
        print_json(nest_settings(make_router_settings(listen, security.settings, links)))
        return
    require_linux("a router")
    if state is None and security.fleet:
        router_place = replace(router_place, state=default_state(security.fleet))
    prepare_router_process()
    warning = describe_openness(listen) if insecure else ""
    if warning:
        errors.print(warning, style="bold red", highlight=False, soft_wrap=True)
    run_main(_route(router_place))


async def _route(place: "RouterPlace") -> None:
    from orchestrator.bus.zenoh.probe import probe_router
    from orchestrator.clock.service_manager import READY, ServiceManager
    from orchestrator.runtime.services.router import RouterService, find_own_endpoint

    def print_line(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    def announce() -> None:
        print_line(f"router on {place.listen}")
        manager.notify(READY)

    manager, probe_count = ServiceManager(), 0

    async def probe() -> None:
        """Count the sessions that it serves, for the watchdog of the service manager."""
        nonlocal probe_count
        while manager.watchdog_s is not None:
            if not await probe_router(find_own_endpoint(place.listen)):
                probe_count += 1
            await asyncio.sleep(PROBE_S)

    tasks_beside = TaskOwner()
    for work in (probe(), manager.feed_watchdog(lambda: probe_count)):
        tasks_beside.spawn(work)
    running_task = asyncio.ensure_future(RouterService(place, print_line).run(announce))
    call_at_signals(running_task.cancel)
    try:
        await running_task
    except asyncio.CancelledError:
        return
    finally:
        tasks_beside.cancel_all()
