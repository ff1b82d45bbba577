"""`tutti axis take` and `release`: axes kept from jobs and other people while somebody works at them."""

import asyncio
import signal
from typing import TYPE_CHECKING

import click

from orchestrator.cli.common import actor, console, fail, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.job_terms import Span

if TYPE_CHECKING:
    from orchestrator.client import Tutti


@click.command(epilog='Example: tutti axis take gantry stage.u --for 2h --what "new belt"')
@click.argument("axes", nargs=-1, required=True)
@click.option("--for", "seconds", default=None, type=Span(), help="Until then, or `release`; at most 24h.")
@click.option("--what", default="manual work", show_default=True, help="Shown to those who wait.")
@fleet_options
@json_option
def take(
    axes: tuple[str, ...], seconds: float | None, what: str, connect: str, fleet: str | None, as_json: bool
) -> None:
    """Take AXES (axes, groups or controllers) for work by hand: jobs that need them wait, other people are refused.

    With --for the axes stay taken when this command has ended, also when a permit is lost or the coordinator starts
    anew; without it, until Ctrl-C. Nothing here keeps power from a motor: to reach into a machine, lock it out.
    """

    async def act(tutti: "Tutti") -> None:
        if seconds is not None:
            taken, holder = await tutti.reserve(list(axes), seconds, what)
            if as_json:
                print_json({"holder": holder, "axes": taken})
            else:
                console.print(f"taken: {', '.join(taken)}; give them back with `tutti axis release`", highlight=False)
            return
        async with tutti.by_hand(list(axes), what=what) as hand:
            if as_json:
                print_json({"holder": hand.holder, "axes": hand.axes})
            else:
                console.print(f"taken: {', '.join(hand.axes)}; Ctrl-C gives them back", highlight=False)
            ended = asyncio.Event()
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                asyncio.get_running_loop().add_signal_handler(number, ended.set)
            while not ended.is_set():
                try:
                    async with asyncio.timeout(0.5):
                        await ended.wait()
                except TimeoutError:
                    if hand.lost is not None:
                        fail(f"the axes are not yours any more: {hand.lost.text}", remedy=hand.lost.remedy)
        console.print("given back", highlight=False)

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti axis release gantry")
@click.argument("axes", nargs=-1)
@click.option("--force", is_flag=True, help="Also what somebody else has taken: ask them first.")
@fleet_options
@json_option
def release(axes: tuple[str, ...], force: bool, connect: str, fleet: str | None, as_json: bool) -> None:
    """Give back AXES (axes or controllers; without: all) that you have taken, with all that was taken with them."""

    async def act(tutti: "Tutti") -> None:
        wanted = {name.partition(".")[0] for name in axes}
        hands = [lease for lease in await tutti.leases() if (lease.holder or "").startswith("hand-")]
        found = [lease for lease in hands if not wanted or lease.controller in wanted]
        others = [lease for lease in found if lease.actor != actor()]
        if others and wanted and not force:
            first = others[0]
            fail(
                f"{first.controller} is taken by {first.actor} ({first.what})", remedy="ask them, and then say --force"
            )
        holders = {lease.holder: lease for lease in found if force or lease.actor == actor()}
        for holder in holders:
            assert holder is not None
            await tutti.give_back(holder)
        if as_json:
            print_json({"released": [lease.controller for lease in found if lease.holder in holders]})
        else:
            console.print(f"{len(holders)} given back" if holders else "nothing is taken", highlight=False)

    with_fleet(connect, fleet, act)
