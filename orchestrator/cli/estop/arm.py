"""`tutti estop --armed`: connects the button with its triggers and the bus until Ctrl-C."""

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import NamedTuple

from orchestrator.bus.base import Bus
from orchestrator.bus.zenoh.bus import ZenohBus, open_bus
from orchestrator.bus.zenoh.sessions import RouterUnreachable
from orchestrator.cli.base.common import console
from orchestrator.cli.estop.button import EstopButton, FindLatched
from orchestrator.cli.estop.triggers import TriggerLost, watch_port, watch_standard_input
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority
from orchestrator.clock.signals import call_at_signals

CONNECT_S = 1.0  # of one try

LOUD = {"not-connected", "not-sent", "not-latched", "port-lost", "sent", "latched"}

SAFETY = "This is software and no safety function: a machine that can hurt a person needs a wired emergency stop."


class ArmedOptions(NamedTuple):
    """Options of the command. port: a serial port whose lines press the button, too; empty: none."""

    connect: str
    fleet: str | None
    reason: str
    port: str
    as_json: bool


async def run_armed(options: ArmedOptions, new_event: Callable[[], tuple[str, str]], find_latched: FindLatched) -> None:
    """Keep the button armed until SIGINT or SIGTERM. Raises `TriggerLost` when nothing can press it any more."""
    loop, end, lost_event, opened_buses = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event(), list[ZenohBus]()
    set_realtime_priority(RealtimePriority.BUS)
    call_at_signals(end.set)

    def report(kind: str, text: str) -> None:
        if options.as_json:
            print(json.dumps({"kind": kind, "text": text}), flush=True)
        else:
            style = "bold red" if kind in LOUD else None
            bell = "\a" if kind in LOUD and console.is_terminal else ""
            console.print(bell + text, style=style, markup=False, highlight=False, soft_wrap=True)

    async def connect() -> Bus:
        while True:
            try:
                opened_buses.append(await open_bus(options.connect, CONNECT_S))
                return opened_buses[0]
            except RouterUnreachable:
                await asyncio.sleep(CONNECT_S)

    button = EstopButton(options.fleet, options.reason, new_event, find_latched, report)
    with contextlib.ExitStack() as restore:
        words = ""
        try:
            words = f"{restore.enter_context(watch_standard_input(button.press, lost_event))} here"
        except TriggerLost:
            if not options.port:
                raise
        report("safety", SAFETY)
        if words:
            report("input", f"{words} presses the button; Ctrl-C disarms it")
        trigger = watch_port(options.port, button.press, report) if options.port else _fail_when_lost(lost_event)
        tasks = [loop.create_task(work) for work in (button.run(connect), trigger, _wait_for(end))]
        try:
            await _wait_for_first(tasks)
        finally:
            for bus in opened_buses:
                await bus.close()
    report("disarmed", "disarmed")


async def _wait_for(event: asyncio.Event) -> None:
    await event.wait()


async def _fail_when_lost(lost: asyncio.Event) -> None:
    await lost.wait()
    raise TriggerLost("disarmed: standard input has ended, so nothing can press the button any more")


async def _wait_for_first(tasks: "list[asyncio.Task[None]]") -> None:
    """Wait for the first of the tasks to end, raise its error, and cancel the others."""
    done_tasks, other_tasks = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in other_tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    for task in done_tasks:
        task.result()
