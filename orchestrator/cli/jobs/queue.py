"""`tutti queue …`: the queue as a whole."""

from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.restart import StartPreview
    from orchestrator.model.report import QueueState


@click.group(epilog="Example: tutti queue start")
def queue() -> None:
    """Start, stop and show the queue.

    After a break no waiting job begins until the queue is started: a restart of the fleet, a stop, an e-stop, an
    interrupted step, or a controller that was off, restarted or unreferenced meanwhile. A job that had to wait for a
    cause (a permit, an e-stop, a fault, a reference, a motor, a controller), and those behind it, begin only by
    `tutti queue start` once that is gone. One job is held and released by `tutti job hold` and `release`.
    """


@queue.command(epilog="Example: tutti job ls && tutti queue start")
@fleet_options
@json_option
def start(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Let waiting jobs begin, also those that had to wait for a cause which is gone.

    What moves first is printed; `tutti queue status` shows it without starting anything. Jobs whose cause lasts stay
    where they are.
    """

    async def start_queue(tutti: "Tutti") -> None:
        preview = await tutti.preview_start()
        if not as_json:
            _print_start(preview)
        await tutti.start_queue(preview)
        await _print_queue(tutti, as_json=as_json, preview=preview)

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
    """Show whether jobs begin, how many wait, and what would move first if the queue was started."""

    async def show_queue(tutti: "Tutti") -> None:
        preview = await tutti.preview_start()
        await _print_queue(tutti, as_json=as_json, preview=preview)
        if not as_json:
            _print_start(preview)

    with_fleet(connect, fleet, show_queue)


def _print_start(preview: "StartPreview") -> None:
    from orchestrator.monitor.queue_words import describe_start

    for line in describe_start(preview):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


async def _print_queue(tutti: "Tutti", *, as_json: bool, preview: "StartPreview | None" = None) -> None:
    from orchestrator.monitor.queue_words import describe_queue

    state = await tutti.list_jobs(limit=1)
    if as_json:
        stop = None if state.stopped is None else state.stopped.to_plain()
        motions = {} if preview is None else {key: preview.to_plain()[key] for key in ("motions", "lasting")}
        journal = {} if state.journal is None else {"journal": state.journal}
        print_json({"stopped": stop, "waiting": state.waiting, **journal, **motions})
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
    """Print why no job begins, if the queue is stopped; and on how many machines its journal is, if it is in a
    database."""
    from orchestrator.monitor.queue_words import describe_queue

    if queue is not None and queue.stopped is not None:
        console.print(describe_queue(queue), style="bold yellow", highlight=False, markup=False)
    elif queue is not None and queue.journal is not None:
        console.print(f"journal: {queue.journal}", highlight=False, markup=False)
