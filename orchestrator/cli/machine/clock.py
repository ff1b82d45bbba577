"""`tutti clock …`: the estimates of the controllers' clocks."""

from datetime import UTC, datetime, timedelta

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.completion import complete_controllers
from orchestrator.model.queue import format_utc
from orchestrator.model.state import ClockMapping, ClockReply, LearnedCrystal
from orchestrator.model.steps.numbers import name_step


@click.group(epilog="Example: tutti clock ls")
def clock() -> None:
    """Show the controllers' own clocks, which time their starts: their rates, and the bounds of the estimates."""


@clock.command(epilog="Example: tutti clock ls")
@fleet_options
@json_option
def ls(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """List every controller's clock.

    rate: by how much its ticks are too long. bound: the guaranteed error of a prediction now and in 5 s. For a
    controller without a readable clock: its rate and the guaranteed error of that, learned from the given number of
    moves.
    """
    from orchestrator.client import Tutti
    from orchestrator.client.clocks import query_clocks
    from orchestrator.monitor.tables import make_plain_table

    async def list_clocks(tutti: Tutti) -> None:
        clocks = await query_clocks(tutti)
        if not clocks:
            raise await tutti.find_absence()
        if as_json:
            print_json({name: reply.to_plain() for name, reply in clocks.items()})
            return
        table = make_plain_table(
            ["controller", "starts by", "rate>", "bound>", "in 5 s>", "age>", "samples>", "residual>"]
        )
        lines: list[str] = []
        for name, reply in clocks.items():
            table.add_row(name, ", ".join(reply.start_classes), *_make_cells(reply.mapping, reply.crystal))
            lines += describe_learned(reply, datetime.now(UTC))
        console.print(table)
        for line in lines:
            console.print(line, highlight=False)

    with_fleet(connect, fleet, list_clocks)


@clock.command(epilog="Example: tutti clock show gantry")
@click.argument("controller", shell_complete=complete_controllers)
@fleet_options
@json_option
def show(controller: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Show the estimate of one controller's clock."""
    from orchestrator.client import Tutti
    from orchestrator.client.clocks import query_clocks
    from orchestrator.client.connection import absence_refusal

    async def show_clock(tutti: Tutti) -> None:
        clocks = await query_clocks(tutti)
        if controller not in clocks:
            raise absence_refusal(controller)
        reply = clocks[controller]
        if as_json:
            print_json(reply.to_plain())
            return
        for name, words in _make_lines(reply):
            console.print(f"{name:<12} {words}", highlight=False)

    with_fleet(connect, fleet, show_clock)


@clock.command(epilog="Example: tutti clock forget stage")
@click.argument("controller", shell_complete=complete_controllers)
@fleet_options
@json_option
def forget(controller: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Forget what unusual starts have added to the bounds of a controller's starts, and how long it takes to be armed.

    The former are forgotten by themselves within five minutes. The latter are in the journal too; without them its next
    16 steps have the lead times that it declares. Nothing is sent to the controller.
    """
    from orchestrator.client import Tutti
    from orchestrator.model.messages import ForgetRequest, Reply

    async def forget_starts(tutti: Tutti) -> None:
        request = ForgetRequest(**tutti.request_fields())
        await tutti.request_controller(controller, "forget", request, Reply)
        await tutti.forget_times(controller)
        if as_json:
            print_json({"controller": controller, "forgotten": True})
        else:
            console.print(f"{controller}: learned bounds of its starts, and its times, are forgotten", highlight=False)

    with_fleet(connect, fleet, forget_starts)


def describe_learned(reply: ClockReply, now: datetime) -> list[str]:
    """What was learned from unusual starts, from which and when, and what is left of it. now: UTC."""
    if not reply.unusual_starts:
        return []
    from orchestrator.monitor.times import format_time

    lines: list[str] = []
    for start in reply.unusual_starts:
        at = format_time(format_utc(now - timedelta(microseconds=start.age_ns / 1000)))
        step = f" of job {start.job}, {name_step(start.step)}," if start.step is not None else ""
        lines.append(
            f"{reply.controller}: the start{step} learned at {at}, was {abs(start.outside_ns) / 1e6:.1f} ms "
            f"{'later' if start.outside_ns > 0 else 'earlier'} than declared; "
            f"{start.remaining_ns / 1e6:.1f} ms are left"
        )
    return [*lines, f"{reply.controller}: these starts widen the bounds of a start by {reply.widened_ns / 1e6:.1f} ms"]


def _make_cells(mapping: ClockMapping | None, crystal: LearnedCrystal | None) -> list[str]:
    if mapping is None and crystal is not None:
        knowledge = f"{crystal.moves} moves" if crystal.consistent else "outside the model"
        return [f"{-crystal.rate_ppm:+.1f} ppm", f"{crystal.bound_ppm:.1f} ppm", "", "", knowledge, ""]
    if mapping is None:
        return ["no clock", "", "", "", "", ""]
    return [
        f"{mapping.rate_ppm:+.1f} ppm",
        _format_ms(_bound_ns(mapping, 0)),
        _format_ms(_bound_ns(mapping, 5_000_000_000)),
        f"{mapping.age_ns / 1e9:.1f} s",
        str(mapping.samples),
        _format_ms(mapping.residual_ns) if mapping.consistent else "outside the model",
    ]


def _make_lines(reply: ClockReply) -> list[tuple[str, str]]:
    mapping, crystal = reply.mapping, reply.crystal
    if mapping is None and crystal is not None:
        fits = "fits" if crystal.consistent else "did not fit the last move: earlier moves are discarded"
        return [
            ("starts by", ", ".join(reply.start_classes)),
            ("clock", "not readable"),
            ("crystal", f"{crystal.rate_ppm:+.2f} ppm fast, learned from {crystal.moves} moves"),
            ("bound", f"{crystal.bound_ppm:.2f} ppm, guaranteed; standard deviation {crystal.error_ppm:.2f} ppm"),
            ("residual", f"the mean distance of the last measurements is {crystal.residual_ppm:.2f} ppm"),
            ("model", fits),
        ]
    if mapping is None:
        return [("starts by", ", ".join(reply.start_classes)), ("clock", "not readable, or not estimated yet")]
    return [
        ("starts by", ", ".join(reply.start_classes)),
        ("tick", f"{mapping.tick_ns / 1e3:.4f} µs of its host's clock, {mapping.rate_ppm:+.2f} ppm off"),
        (
            "offset",
            f"tick {mapping.ticks_at} began {mapping.age_ns / 1e9:.3f} s ago, host time {mapping.host_at_ns}",
        ),
        (
            "bound",
            f"{_format_ms(_bound_ns(mapping, 0))} now, growing by {mapping.drift_ppm:.2f} µs per second; guaranteed",
        ),
        ("readings", f"{mapping.samples}, mean distance {_format_ms(mapping.residual_ns)} from the mapping"),
        ("model", "fits" if mapping.consistent else "does not fit: a crystal beyond 100 ppm, or a clock that was set"),
        ("round trips", f"the fastest took {_format_ms(mapping.min_rtt_ns)}"),
    ]


def _bound_ns(mapping: ClockMapping, ahead_ns: int) -> float:
    return mapping.bound_ns + (mapping.age_ns + ahead_ns) * mapping.drift_ppm * 1e-6


def _format_ms(ns: float) -> str:
    return f"{ns / 1e6:.2f} ms"
