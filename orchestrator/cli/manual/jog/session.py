"""The running jog panel: keys from the terminal, states from the bus, requests to the bus, ten screens per second."""

import asyncio
import contextlib
from collections.abc import Coroutine, Mapping
from typing import Any, Self

from pydantic import ValidationError

from orchestrator.bus.base import BusSample
from orchestrator.bus.states.frame import Confirmation
from orchestrator.cli.base.codes import INTERRUPTED
from orchestrator.cli.manual.jog.keys import FocusChange, KeyEvent, TerminalEvent
from orchestrator.cli.manual.jog.panel import (
    AcquireAxis,
    JogAxis,
    JogPanel,
    PanelAction,
    ReleaseAxis,
    RequestFleetEstop,
    RequestFleetStop,
    StopJog,
)
from orchestrator.cli.manual.jog.screen import render_panel
from orchestrator.cli.manual.jog.terminal import ESCAPE_TIMEOUT_S, RawTerminal
from orchestrator.cli.manual.jog.work import CancelWork, RunWork
from orchestrator.cli.manual.jog.work_runner import WorkRunner
from orchestrator.client import Tutti
from orchestrator.client.manual import ManualControl
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.live import raw_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.errors import Refusal
from orchestrator.model.report import LeaseState
from orchestrator.model.state import ControllerState

REFRESH_S = 0.1
LEASES_TIMEOUT_S = 1.0  # for receiving the existing leases
EXIT_TIMEOUT_S = 2.0  # for stopping and releasing; an axis whose stop request fails has stopped by itself by then


class JogSession:
    """Runs `panel` while the context is open. `ended` gets the exit code, or the error."""

    def __init__(self, tutti: Tutti, panel: JogPanel, terminal: RawTerminal, ended: "asyncio.Future[int]") -> None:
        self._tutti = tutti
        self._panel = panel
        self._terminal = terminal
        self._ended = ended
        self._loop = asyncio.get_running_loop()
        self._hand: ManualControl | None = None
        self._leasing: asyncio.Queue[str | ManualControl | asyncio.Event | None] = asyncio.Queue()
        self._leaving = False
        # The panel waits for the ends of requests on exit.
        self._requests, self._endless = TaskOwner(self._end_at_defect), TaskOwner(self._end_at_defect)
        self._works = WorkRunner(tutti, panel, self._start_request)
        self._timer: asyncio.TimerHandle | None = None
        self._escape: asyncio.TimerHandle | None = None

    async def __aenter__(self) -> Self:
        for work in (self._subscribe_states(), self._draw_screens()):
            self._endless.spawn(work)
        self._start_request(self._manage_leases())
        self._loop.add_reader(self._terminal.fd_in, self._on_readable)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._leaving = True
        self._loop.remove_reader(self._terminal.fd_in)
        for timer in (self._timer, self._escape):
            if timer is not None:
                timer.cancel()
        self._endless.cancel_all()
        self._works.cancel()
        self._release_axes()
        self._leasing.put_nowait(None)
        if requests := self._requests.pending:
            await asyncio.wait(requests, timeout=EXIT_TIMEOUT_S)

    # Input

    def _on_readable(self) -> None:
        if self._escape is not None:
            self._escape.cancel()
            self._escape = None
        events = self._terminal.read_events()
        if events is None:
            self._end_session(INTERRUPTED)
            return
        self._handle_events(events)
        if self._terminal.is_incomplete:
            self._escape = self._loop.call_later(
                ESCAPE_TIMEOUT_S, lambda: self._handle_events(self._terminal.expire_sequence())
            )

    def _handle_events(self, events: list[TerminalEvent]) -> None:
        for event in events:
            if isinstance(event, KeyEvent):
                self._perform_actions(self._panel.handle_key(event, raw_ns()))
            elif isinstance(event, FocusChange):
                self._perform_actions(self._panel.handle_focus(event, raw_ns()))

    async def _subscribe_states(self) -> None:
        keys = self._tutti.keys
        async with self._tutti.follow_all(keys.leases) as stream:
            stream.on_confirmed = self._note_confirmed
            for state in (await self._tutti.status()).values():
                self._panel.store_state(state, raw_ns())
            for payload in (await self._tutti.bus.request_all(keys.leases, b"", LEASES_TIMEOUT_S)).values():
                self._receive_sample(BusSample(keys.leases, payload))
            while True:
                self._receive_sample(await stream.queue.get())

    def _note_confirmed(self, confirmations: Mapping[str, Confirmation]) -> None:
        """States that hold still do not arrive again."""
        now_ns = raw_ns()
        for controller, confirmation in confirmations.items():
            if controller in self._panel.states:
                self._panel.seen_ns[controller] = now_ns - confirmation.age_ns

    def _receive_sample(self, sample: BusSample) -> None:
        # A controller with another protocol version is not shown; its axes show no state.
        with contextlib.suppress(ValidationError):
            if sample.key.endswith("/state"):
                self._panel.store_state(ControllerState.read_message(sample.payload), raw_ns())
            elif "/lease/" in sample.key:
                self._panel.store_lease(LeaseState.read_message(sample.payload))

    # Output

    async def _draw_screens(self) -> None:
        while True:
            columns, rows = self._terminal.get_size()
            self._terminal.show_image(render_panel(self._panel, raw_ns(), columns, rows))
            await asyncio.sleep(REFRESH_S)
            if self._hand is not None:
                self._check_lease(self._hand)

    def _perform_actions(self, actions: list[PanelAction]) -> None:
        """Perform the actions of the panel in order, and schedule its next tick."""
        if self._leaving:
            return
        for action in actions:
            if isinstance(action, AcquireAxis):
                self._leasing.put_nowait(action.axis)
            elif isinstance(action, ReleaseAxis):
                self._release_axes()
            elif isinstance(action, JogAxis):
                self._start_request(self._send_jog(action))
            elif isinstance(action, StopJog):
                self._start_request(self._stop_jog())
            elif isinstance(action, RunWork | CancelWork):
                self._handle_work(action)
            elif isinstance(action, RequestFleetStop):
                self._start_request(self._stop_fleet())
            elif isinstance(action, RequestFleetEstop):
                self._start_request(self._estop_fleet())
            else:
                self._end_session(action.code)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        due_ns = self._panel.next_tick_ns()
        if due_ns is not None:
            self._timer = self._loop.call_later(max(0, due_ns - raw_ns()) / NS_PER_S, self._handle_tick)

    def _handle_work(self, action: RunWork | CancelWork) -> None:
        if isinstance(action, RunWork):
            # Its job acquires the axis: it waits for the release before.
            self._leasing.put_nowait(self._works.start(action))
        else:
            self._works.cancel()

    def _handle_tick(self) -> None:
        self._perform_actions(self._panel.handle_time(raw_ns()))

    def _release_axes(self) -> None:
        if self._hand is not None:
            self._leasing.put_nowait(self._hand)
            self._hand = None

    async def _manage_leases(self) -> None:
        """Acquire and release leases one after the other: an axis can be acquired again only after its release. None
        ends the loop."""
        while (target := await self._leasing.get()) is not None:
            if isinstance(target, ManualControl):
                await target.release()
                continue
            if isinstance(target, asyncio.Event):
                target.set()
                continue
            hand = self._tutti.manual_control([target], what="jog panel")
            try:
                await hand.acquire()
            except Refusal as error:
                self._panel.handle_acquire_refused(error)
                continue
            if self._leaving:
                await hand.release()
                continue
            self._hand = hand
            self._perform_actions(self._panel.handle_acquired(hand.axes, hand.holder, raw_ns()))

    async def _send_jog(self, jog: JogAxis) -> None:
        hand, refusal = self._hand, None
        if hand is None:
            return
        try:
            await (hand.renew_jog if jog.renew else hand.jog)({jog.axis: jog.velocity})
        except Refusal as error:
            refusal = error
        self._check_lease(hand)
        self._perform_actions(self._panel.handle_jog_reply(jog, refusal, raw_ns()))

    def _check_lease(self, hand: ManualControl) -> None:
        """Check whether the lease has ended early."""
        if hand is self._hand and hand.lost is not None:
            self._panel.handle_lease_lost(hand.lost)
            self._release_axes()

    async def _stop_jog(self) -> None:
        if self._hand is not None:
            try:
                await self._hand.stop()
            except Refusal as error:
                self._panel.handle_stop_refused(error)

    async def _stop_fleet(self) -> None:
        answers = await self._tutti.stop()
        wrong = [refusal.text for refusal in answers.values() if refusal is not None]
        self._panel.show_note(
            f"NOT STOPPED: {'; '.join(wrong)}" if wrong else f"stopped: {', '.join(answers) or 'nothing'}"
        )

    async def _estop_fleet(self) -> None:
        latched_estop = await self._tutti.estop("at the jog panel")
        wrong = [controller for controller, is_latched in latched_estop.items() if not is_latched]
        if wrong or not latched_estop:
            self._panel.show_note(f"NOT LATCHED: {', '.join(wrong) or 'no controller answers'}; use the wired e-stop")
        else:
            self._panel.show_note(f"e-stop latched: {', '.join(latched_estop)}")

    # Tasks

    def _start_request(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a request that ends by itself; the panel waits for it on exit."""
        self._requests.spawn(work)

    def _end_at_defect(self, error: BaseException, _: bool) -> None:  # noqa: FBT001 - a callback
        """End the panel at a defect: no jog without a display."""
        if not self._ended.done():
            self._ended.set_exception(error)

    def _end_session(self, code: int) -> None:
        if not self._ended.done():
            self._ended.set_result(code)
