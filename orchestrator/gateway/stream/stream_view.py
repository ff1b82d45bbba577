"""The frames of one need: all readers that need the same get the same texts, made once."""

import json
from collections.abc import Callable
from typing import Any

from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.gateway.stream.fleet_state import FleetState
from orchestrator.gateway.stream.merge_patch import make_patch
from orchestrator.gateway.stream.need import StreamNeed

TICK_NS = 50 * NS_PER_MS
"""Least time between two differences, and between two whole states for one reader, however often it asks for one."""
QUIET_NS = 500 * NS_PER_MS  # longest time without a difference, also if nothing has changed


def encode(value: Any) -> str:
    """Compact JSON."""
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


class StreamView:
    """What is shown for `need`, numbered. Before `advance` it has number 0, and no frame."""

    def __init__(self, need: StreamNeed, state: FleetState, clock: Clock) -> None:
        self.need = need
        self.number = 0
        self.patch = ""
        self.readers: set[StreamReader] = set()
        self._state, self.clock = state, clock
        self._shown: dict[str, Any] = {}
        self._framed_ns = 0
        self._state_frame: tuple[int, str] | None = None

    def make_state_frame(self) -> str:
        """The frame with the whole state, as of the newest difference."""
        if self._state_frame is None or self._state_frame[0] != self.number:
            self._state_frame = self.number, encode({"n": self.number, "state": self._shown})
        return self._state_frame[1]

    def advance(self, *, changed: bool) -> None:
        """Make the next difference, if there is one or it is time for one. changed: the fleet may be another."""
        is_due = self.number == 0 or self.clock.now_ns() - self._framed_ns >= QUIET_NS
        if not changed and not is_due:
            return
        shown_before, self._shown = self._shown, self._state.compose(self.need)
        patch = make_patch(shown_before, self._shown)
        if not patch and not is_due:
            return
        self._framed_ns = self.clock.now_ns()
        self.number += 1
        self.patch = encode({"n": self.number, "patch": patch})
        for reader in list(self.readers):
            reader.wake()


class StreamReader:
    """One reader, which chooses its view. `wake` is called when there is something new; `take_frame` returns it."""

    def __init__(self, view: StreamView, choose_view: Callable[["StreamReader", StreamNeed | None], None]) -> None:
        self.view = view
        self.wake: Callable[[], None] = lambda: None
        self._choose_view = choose_view
        self._number: int | None = None
        self._whole_ns: int | None = None
        """When it has taken the whole state last."""

    def take_frame(self) -> str | None:
        """The newest difference, or the whole state if the reader has missed one; None: nothing is new, or the whole
        state was taken a moment ago, and goes with the next difference."""
        view = self.view
        if view.number in (0, self._number):
            return None
        if self._number == view.number - 1:
            self._number = view.number
            return view.patch
        now_ns = view.clock.now_ns()
        if self._whole_ns is not None and now_ns < self._whole_ns + TICK_NS:
            return None
        self._number, self._whole_ns = view.number, now_ns
        return view.make_state_frame()

    def forget(self) -> None:
        """Let the next frame be the whole state."""
        self._number = None
        self.wake()

    def choose(self, need: StreamNeed) -> None:
        """Need something else from now on; the next frame is the whole state of it."""
        self._choose_view(self, need)
        self.forget()

    def close(self) -> None:
        """End it."""
        self._choose_view(self, None)
