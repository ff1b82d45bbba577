"""`tutti watch`: the fleet and the running job, live."""

import click

from orchestrator.cli.common import console, fleet_options, with_fleet

REFRESH_HZ = 10


@click.command(epilog="Example: tutti watch   (Ctrl-C ends only the display)")
@fleet_options
def watch(connect: str, fleet: str | None) -> None:
    """Watch axes, events and the running job. Prints plain lines when the output is not a terminal."""
    from rich.live import Live

    from orchestrator.client import Tutti
    from orchestrator.monitor.fleet_view import LiveView

    async def act(tutti: Tutti) -> None:
        view = LiveView(tutti.keys)
        async with tutti.subscribe_samples(*view.expressions) as samples:
            view.states = await tutti.status()
            if not console.is_terminal:
                while True:
                    line = view.take(await samples.get())
                    if line is not None:
                        console.print(line, highlight=False, markup=False, soft_wrap=True)
            with Live(get_renderable=view.render, console=console, refresh_per_second=REFRESH_HZ):
                while True:
                    view.take(await samples.get())

    with_fleet(connect, fleet, act)
