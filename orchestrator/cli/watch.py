"""`tutti watch`: the fleet and the running job, live."""

import json
import time

import click

from orchestrator.cli.base.common import can_redraw, console, fleet_options, json_option, with_fleet
from orchestrator.cli.queue import load_queue

REFRESH_HZ = 10


@click.command(epilog="Example: tutti watch   (Ctrl-C ends only the display)")
@fleet_options
@json_option
def watch(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Watch axes, events and the running job. Prints plain lines when the output is not a terminal; with --json each
    message of the fleet, as one line `{"key", "value"}`."""
    from rich.live import Live

    from orchestrator.client import Tutti
    from orchestrator.monitor.fleet_view import LiveView

    async def watch_fleet(tutti: Tutti) -> None:
        view = LiveView(tutti.keys, time.monotonic)
        async with tutti.subscribe_samples(*view.key_expressions) as samples:
            if as_json:
                while True:
                    key, payload = await samples.get()
                    click.echo(json.dumps({"key": key, "value": json.loads(payload)}))
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
