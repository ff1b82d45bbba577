"""`tutti watch`: the fleet and the running jobs, live."""

import asyncio
import json
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import INTERRUPTED
from orchestrator.cli.base.common import can_redraw, console, fleet_options, json_option, with_fleet
from orchestrator.cli.base.terminal import HAS_PANELS
from orchestrator.cli.jobs.queue import load_queue
from orchestrator.clock.signals import TERMINAL_SIGNALS, call_at_signals

if TYPE_CHECKING:
    from orchestrator.bus.base import BusSample
    from orchestrator.bus.states.frame import Confirmation
    from orchestrator.cli.manual.jog.keys import TerminalEvent
    from orchestrator.cli.manual.jog.terminal import RawTerminal
    from orchestrator.cli.view.watch.panel import WatchPanel
    from orchestrator.client import Tutti
    from orchestrator.client.connection import FollowedSamples
    from orchestrator.monitor.fleet_view import LiveView

REFRESH_S = 0.1
LINES_CHECK_S = 0.5


@click.command(epilog="Example: tutti watch   (q or Ctrl-C ends only the display)")
@fleet_options
@json_option
def watch(connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Watch axes, jobs and events. ↑/↓ and PgUp/PgDn scroll, / filters, q leaves.

    Prints plain lines when the output is not a terminal, and on Windows; with --json each message of the fleet, as one
    line `{"key", "value"}`.
    """
    from orchestrator.cli.base.names import require_states
    from orchestrator.model.errors import Refusal
    from orchestrator.monitor.fleet_view import LiveView

    async def watch_fleet(tutti: "Tutti") -> None:
        view = LiveView(tutti.keys, time.monotonic, connect)
        async with tutti.follow_all(*view.key_expressions) as stream:
            samples = stream.queue
            view.take_states(await require_states(tutti), await tutti.list_leases())
            view.queue = await load_queue(tutti)
            with suppress(Refusal):  # without a coordinator
                view.take_alarms(await tutti.list_alarms())
            if as_json:
                await _print_messages(samples)
            if not (HAS_PANELS and can_redraw() and sys.stdin.isatty()):
                await _print_lines(view, stream)
            await _run_screen(view, stream)

    with_fleet(connect, fleet, watch_fleet)


async def _print_messages(samples: "asyncio.Queue[BusSample]") -> None:
    while True:
        key, payload = await samples.get()
        click.echo(json.dumps({"key": key, "value": json.loads(payload)}))


async def _print_lines(view: "LiveView", stream: "FollowedSamples") -> None:
    from orchestrator.cli.view.watch.connection import ConnectionWatch
    from orchestrator.monitor.times import format_time

    connection = ConnectionWatch(time.monotonic)

    def print_line(line: str | None) -> None:
        if line is not None:
            console.print(line, highlight=False, markup=False, soft_wrap=True)

    def print_note(line: str | None) -> None:
        print_line(None if line is None else f"{format_time(_utc_now(), precise=True)} {line}")

    def note_confirmed(confirmations: "Mapping[str, Confirmation]") -> None:
        view.note_confirmed(confirmations)
        print_note(connection.note_sample())

    samples, stream.on_confirmed = stream.queue, note_confirmed
    print_note(view.openness or None)
    while True:
        try:
            async with asyncio.timeout(LINES_CHECK_S):
                sample = await samples.get()
        except TimeoutError:
            print_note(connection.check_silence())
            continue
        print_note(connection.note_sample())
        print_line(view.take_sample(sample))


async def _run_screen(view: "LiveView", stream: "FollowedSamples") -> None:
    from orchestrator.cli.manual.jog.terminal import RawTerminal
    from orchestrator.cli.view.watch.panel import WatchPanel

    panel = WatchPanel(view, time.monotonic, _utc_now)
    samples, stream.on_confirmed = stream.queue, panel.note_confirmed
    loop = asyncio.get_running_loop()
    end: asyncio.Future[int] = loop.create_future()

    def end_screen(code: int) -> None:
        if not end.done():
            end.set_result(code)

    call_at_signals(lambda: end_screen(INTERRUPTED), TERMINAL_SIGNALS)
    with RawTerminal(sys.stdin.fileno(), sys.stdout.fileno()) as terminal:
        keys = _KeyReader(terminal, panel, end_screen)
        loop.add_reader(terminal.fd_in, keys.read_keys)
        try:
            while not end.done():
                while not samples.empty():
                    panel.take_sample(samples.get_nowait())
                panel.check_time()
                _, panel.rows = terminal.get_size()
                terminal.show_image(panel)
                await asyncio.wait([end], timeout=REFRESH_S)
        finally:
            loop.remove_reader(terminal.fd_in)
    if end.result():
        raise SystemExit(end.result())


def _utc_now() -> str:
    from orchestrator.clock.utc import format_rfc3339

    return format_rfc3339(datetime.now(UTC))


class _KeyReader:
    """Hands the keys of the terminal to the panel."""

    def __init__(self, terminal: "RawTerminal", panel: "WatchPanel", end: Callable[[int], None]) -> None:
        self._terminal = terminal
        self._panel = panel
        self._end = end

    def read_keys(self) -> None:
        """Handle what has arrived."""
        from orchestrator.cli.manual.jog.terminal import ESCAPE_TIMEOUT_S

        events = self._terminal.read_events()
        if events is None:
            self._end(INTERRUPTED)
            return
        self._handle_events(events)
        if self._terminal.is_incomplete:
            loop = asyncio.get_running_loop()
            loop.call_later(ESCAPE_TIMEOUT_S, lambda: self._handle_events(self._terminal.expire_sequence()))

    def _handle_events(self, events: "list[TerminalEvent]") -> None:
        from orchestrator.cli.manual.jog.keys import KeyEvent

        for event in events:
            if not isinstance(event, KeyEvent):
                continue
            if event.name == "ctrl+c":
                self._end(INTERRUPTED)
            elif self._panel.handle_key(event):
                self._end(0)
