"""`tutti queue …`: the queue as a whole."""

from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.report import QueueState


@click.group(epilog="Example: tutti queue start")
def queue() -> None:
    """Start, stop and show the queue.

    After a break no waiting job begins until the queue is started: a restart of the fleet, a stop, an e-stop, an
    interrupted step, or a controller that was off, restarted or unreferenced meanwhile. One job is held and released by
    `tutti job hold` and `release`.
    """


@queue.command(epilog="Example: tutti job ls && tutti queue start")
@fleet_options
@json_option
def start(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Let waiting jobs begin. Look at them before: `tutti job ls`."""

    async def start_queue(tutti: "Tutti") -> None:
        await tutti.start_queue()
        await _print_queue(tutti, as_json=as_json)

    with_fleet(connect, fleet, start_queue)


@queue.command(epilog="Example: tutti queue stop")
@fleet_options
@json_option
def stop(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Let no further job begin. Running jobs continue; `tutti stop` stops them."""

    async def stop_queue(tutti: "Tutti") -> None:
        await tutti.stop_queue()
        await _print_queue(tutti, as_json=as_json)

    with_fleet(connect, fleet, stop_queue)


@queue.command(epilog="Example: tutti queue status --json")
@fleet_options
@json_option
def status(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Show whether jobs begin, and how many wait."""

    async def show_queue(tutti: "Tutti") -> None:
        await _print_queue(tutti, as_json=as_json)

    with_fleet(connect, fleet, show_queue)


async def _print_queue(tutti: "Tutti", *, as_json: bool) -> None:
    from orchestrator.monitor.queue_words import describe_queue

    state = await tutti.list_jobs(limit=1)
    if as_json:
        print_json({"stopped": None if state.stopped is None else state.stopped.to_plain(), "waiting": state.waiting})
    else:
        console.print(describe_queue(state), highlight=False, markup=False)


async def load_queue(tutti: "Tutti") -> "QueueState | None":
    """The state of the queue; None without a coordinator."""
    from orchestrator.model.errors import Refusal

    try:
        return await tutti.list_jobs(limit=1)
    except Refusal:
        return None


def print_queue_stop(queue: "QueueState | None") -> None:
    """Print why no job begins, if the queue is stopped."""
    from orchestrator.monitor.queue_words import describe_queue

    if queue is not None and queue.stopped is not None:
        console.print(describe_queue(queue), style="bold yellow", highlight=False, markup=False)
