"""Completion of names in a shell: the running fleet is asked, briefly, and without it nothing is offered."""

import asyncio
import contextlib
import os
from collections.abc import Awaitable, Callable, Iterable
from typing import TYPE_CHECKING, TypeVar

import click
from click.shell_completion import CompletionItem

from orchestrator.bus.endpoint import DEFAULT_ENDPOINT

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.service import FleetNames

T = TypeVar("T")

CONNECT_S = 0.2
ANSWER_S = 0.3
JOBS_OFFERED = 20

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def complete_names(choose: "Callable[[FleetNames], Iterable[str]]") -> Complete:
    """Make the completion of an argument: the names that `choose` takes from those of the fleet."""

    def complete(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
        names = ask_fleet(context, lambda tutti: tutti.list_names(ANSWER_S))
        return [CompletionItem(name) for name in (choose(names) if names else ()) if name.startswith(begun)]

    return complete


complete_axes = complete_names(lambda names: [*names.axes, *names.groups, *names.controllers, *names.virtual_groups])
complete_targets = complete_names(lambda names: [f"{axis}=" for axis in (*names.axes, *names.virtual)])
complete_single_axes = complete_names(lambda names: names.axes)
complete_positions = complete_names(lambda names: names.positions)
complete_controllers = complete_names(lambda names: names.controllers)
complete_inputs = complete_names(lambda names: names.inputs)
complete_outputs = complete_names(lambda names: names.outputs)


def complete_jobs(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """The newest jobs, by id, with their names where the shell shows help; and `last`."""
    listing = ask_fleet(context, lambda tutti: tutti.list_jobs(limit=JOBS_OFFERED))
    jobs = [] if listing is None else [("last", "the newest job"), *((job.id, job.name) for job in listing.jobs)]
    return [CompletionItem(job_id, help=name) for job_id, name in jobs if job_id.startswith(begun)]


def complete_fleets(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """The fleets on the bus."""
    from orchestrator.bus.fleets import find_fleets

    # Any name will do: only the bus of the connection is used.
    fleets = ask_fleet(context, lambda tutti: find_fleets(tutti.bus), fleet="any")
    return [CompletionItem(name) for name in fleets or () if name.startswith(begun)]


def ask_fleet(
    context: click.Context, question: "Callable[[Tutti], Awaitable[T]]", fleet: str | None = None
) -> T | None:
    """The fleet's answer; None without one in time. A shell waits for it, so that no error is worth a message."""
    connect = context.params.get("connect") or os.environ.get("TUTTI_CONNECT") or DEFAULT_ENDPOINT
    fleet = fleet or context.params.get("fleet") or os.environ.get("TUTTI_FLEET") or None

    async def ask() -> T:
        from orchestrator.bus.zenoh.bus import open_bus
        from orchestrator.client import Tutti

        # Has a limit of its own, and is not cancelled: a process that ends while Zenoh connects ends by SIGABRT.
        bus = await open_bus(connect, CONNECT_S)
        async with asyncio.timeout(ANSWER_S), Tutti(bus, fleet) as tutti:
            return await question(tutti)

    with contextlib.suppress(Exception):
        return asyncio.run(ask())
    return None
