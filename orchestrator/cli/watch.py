"""`tutti watch`: the fleet and the running job, live."""

import time

import click

from orchestrator.cli.base.common import can_redraw, console, fleet_options, with_fleet
from orchestrator.cli.queue import load_queue

REFRESH_HZ = 10


@click.command(epilog="Example: tutti watch   (Ctrl-C ends only the display)")
@fleet_options
def watch(connect: str, fleet: str | None) -> None:
    """Watch axes, events and the running job. Prints plain lines when the output is not a terminal."""
    from rich.live import Live

    from orchestrator.client import Tutti
    from orchestrator.monitor.fleet_view import LiveView

    async def watch_fleet(tutti: Tutti) -> None:
        view = LiveView(tutti.keys, time.monotonic)
        async with tutti.subscribe_samples(*view.key_expressions) as samples:
            view.take_states(await tutti.status(), await tutti.list_leases())
            view.queue = await load_queue(tutti)
            if not can_redraw():
                while True:
                    line = view.take_sample(await samples.get())
                    if line is not None:
                        console.print(line, highlight=False, markup=False, soft_wrap=True)
            with Live(get_renderable=view.render_screen, console=console, refresh_per_second=REFRESH_HZ):
                while True:
                    view.take_sample(await samples.get())

    with_fleet(connect, fleet, watch_fleet)
