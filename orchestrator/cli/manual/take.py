"""`tutti axis acquire` and `release`: axes reserved for manual work, so that jobs and other users cannot use them."""

import asyncio
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import actor_name, console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.completion import complete_axes
from orchestrator.cli.base.durations import DurationType
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.clock.signals import TERMINAL_SIGNALS, call_at_signals

MAX_REASON = 80  # characters

if TYPE_CHECKING:
    from orchestrator.client import Tutti


def _check_reason(_: click.Context, option: click.Parameter, value: str) -> str:
    if len(value) > MAX_REASON:
        raise click.BadParameter(f"{len(value)} characters: at most {MAX_REASON}", param=option)
    return value


@click.command(epilog='Example: tutti axis acquire gantry stage.u --for 2h --what "new belt"')
@click.argument("axes", nargs=-1, required=True, shell_complete=complete_axes)
@click.option(
    "--for", "seconds", default=None, type=DurationType("24h"), help="Duration, at most 24h; or until `release`."
)
@click.option(
    "--what", default="manual work", show_default=True, callback=_check_reason, help="Reason, shown to waiting users."
)
@fleet_options
@json_option
def acquire(
    axes: tuple[str, ...], seconds: float | None, what: str, connect: str, fleet: str | None, *, as_json: bool
) -> None:
    """Acquire AXES (axes, groups or controllers) for manual work: jobs that need them wait, other users are refused.

    With --for the axes stay acquired after this command ends, also when a permit is lost or the coordinator
    restarts; without it, until Ctrl-C. This does not disconnect any motor from power: to reach into a machine, lock
    it out.
    """

    from orchestrator.cli.base.names import require_axes

    async def acquire_axes(tutti: "Tutti") -> None:
        require_axes(await tutti.list_names(), axes)
        if seconds is not None:
            axis_names, holder = await tutti.reserve_axes(list(axes), seconds, what)
            if as_json:
                print_json({"holder": holder, "axes": axis_names})
            else:
                console.print(
                    f"acquired: {', '.join(axis_names)}; release them with `tutti axis release`", highlight=False
                )
            return
        ended_event = asyncio.Event()
        call_at_signals(ended_event.set, TERMINAL_SIGNALS)
        async with tutti.manual_control(list(axes), what=what) as control:
            if as_json:
                print_json({"holder": control.holder, "axes": control.axes})
            else:
                console.print(f"acquired: {', '.join(control.axes)}; Ctrl-C releases them", highlight=False)
            while not ended_event.is_set():
                try:
                    async with asyncio.timeout(0.5):
                        await ended_event.wait()
                except TimeoutError:
                    if control.lost is not None:
                        exit_with_error(
                            f"the axes are no longer acquired: {control.lost.text}",
                            remedy=control.lost.remedy,
                            code=control.lost.code,
                        )
        if not as_json:
            console.print("released", highlight=False)

    with_fleet(connect, fleet, acquire_axes)


@click.command(epilog="Example: tutti axis release gantry")
@click.argument("axes", nargs=-1, shell_complete=complete_axes)
@click.option("--force", is_flag=True, help="Also axes that another user acquired: agree with that user first.")
@fleet_options
@json_option
def release(axes: tuple[str, ...], connect: str, fleet: str | None, *, force: bool, as_json: bool) -> None:
    """Release AXES (axes, groups or controllers; without: all) that you acquired, with all that were acquired together
    with them."""

    from orchestrator.cli.base.names import require_axes

    async def release_axes(tutti: "Tutti") -> None:
        controllers = {name.partition(".")[0] for name in require_axes(await tutti.list_names(), axes)}
        manual = [lease for lease in await tutti.list_leases() if (lease.holder or "").startswith("manual-")]
        leases = [lease for lease in manual if not controllers or lease.controller in controllers]
        other_leases = [lease for lease in leases if lease.actor != actor_name()]
        if other_leases and controllers and not force:
            first = other_leases[0]
            exit_with_error(
                f"{first.controller} is acquired by {first.actor} ({first.what})",
                remedy="agree with that user, then repeat with --force",
                code="leased",
            )
        holders = {lease.holder: lease for lease in leases if force or lease.actor == actor_name()}
        for holder in holders:
            assert holder is not None
            await tutti.release_axes(holder)
        if as_json:
            print_json({"released": [lease.controller for lease in leases if lease.holder in holders]})
        else:
            controller_list = ", ".join(lease.controller for lease in leases if lease.holder in holders)
            console.print(f"released: {controller_list}" if holders else "no axis is acquired", highlight=False)

    with_fleet(connect, fleet, release_axes)
