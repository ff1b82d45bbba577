"""The screen of `tutti watch`, without a terminal and without a bus: keys, samples and time in, lines out."""

import itertools
from collections import deque
from collections.abc import Callable, Mapping

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.segment import Segment
from rich.text import Text

from orchestrator.bus.base import BusSample
from orchestrator.bus.states.frame import Confirmation
from orchestrator.cli.manual.jog.keys import KeyEvent
from orchestrator.cli.view.watch.connection import ConnectionWatch
from orchestrator.model.state import ControllerState
from orchestrator.monitor.fleet_summary import MANY, make_fleet_summary
from orchestrator.monitor.fleet_view import LiveView, make_state_table, name_missing_permits
from orchestrator.monitor.times import format_time

MAX_LINES = 2000  # of events that can be scrolled back to
FRAME_LINES = 3  # head, the line between the panes, keys
MIN_EVENT_LINES = 4
_STEPS = {"up": 1, "down": -1, "pageup": 10, "pagedown": -10}
_KEYS = (("↑/↓ PgUp/PgDn", "scroll"), ("tab", "axes or events"), ("/", "filter"), ("esc", "reset"), ("q", "leave"))

Line = list[Segment]


class WatchPanel:
    """Axes and jobs above, events below, over the whole height. utc: the time of day, for its own lines."""

    def __init__(self, view: LiveView, now_s: Callable[[], float], utc: Callable[[], str]) -> None:
        self.view = view
        self.rows = 24
        self.filter = ""
        self.is_typing = False
        self.connection = ConnectionWatch(now_s)
        self._utc = utc
        self._lines: deque[str] = deque(maxlen=MAX_LINES)
        self._scrolled = {"axes": 0, "events": 0}
        self._pane = "events"

    # Samples and time

    def take_sample(self, sample: BusSample) -> None:
        """Store a sample of the bus."""
        self._add_line(self.connection.note_sample(), stamped=False)
        self._add_line(self.view.take_sample(sample), stamped=True)

    def note_confirmed(self, confirmations: Mapping[str, Confirmation]) -> None:
        """Store how old the states are that hold still."""
        self._add_line(self.connection.note_sample(), stamped=False)
        self.view.note_confirmed(confirmations)

    def check_time(self) -> None:
        """Notice a connection that is lost."""
        self._add_line(self.connection.check_silence(), stamped=False)

    def _add_line(self, line: str | None, *, stamped: bool) -> None:
        if line is None:
            return
        self._lines.append(line if stamped else f"{format_time(self._utc(), precise=True)} {line}")
        if self._scrolled["events"] and self._matches(line):
            # What is being read stays where it is.
            self._scrolled["events"] += 1

    # Keys

    def handle_key(self, key: KeyEvent) -> bool:
        """Handle a key; return whether the screen is to be left."""
        if key.kind == "release":
            return False
        if self.is_typing:
            self._edit_filter(key.name)
            return False
        if key.name in _STEPS:
            # Events scroll back in time, axes down the table.
            direction = 1 if self._pane == "events" else -1
            self._scrolled[self._pane] = max(0, self._scrolled[self._pane] + direction * _STEPS[key.name])
        elif key.name == "tab":
            self._pane = "axes" if self._pane == "events" else "events"
        elif key.name == "/":
            self.is_typing = True
        elif key.name == "escape":
            self.filter, self._scrolled = "", {"axes": 0, "events": 0}
        return key.name in ("q", "Q")

    def _edit_filter(self, name: str) -> None:
        if name in ("enter", "escape"):
            self.is_typing = False
            self.filter = self.filter if name == "enter" else ""
        elif name == "backspace":
            self.filter = self.filter[:-1]
        elif name == "space" or len(name) == 1:
            self.filter += " " if name == "space" else name

    # Output

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        options = options.update(height=None)
        room = max(2, self.rows - FRAME_LINES)
        if len(self.view.states) > MANY:
            top = self._render_many(console, options, max(1, room - MIN_EVENT_LINES))
        else:
            lines_above = console.render_lines(self._render_above(), options, pad=False)
            top = self._cut_top(lines_above, max(1, min(len(lines_above), room - MIN_EVENT_LINES)))
        events_below = self._cut_events(room - len(top), options.max_width)
        head = console.render_lines(self._render_head(), options, pad=False)[:1]
        keys = console.render_lines(self._render_keys(), options, pad=False)[:1]
        segments_between = [[Segment("")]]
        for number, line in enumerate([*head, *top, *segments_between, *events_below, *keys]):
            if number:
                yield Segment.line()
            yield from line

    def _cut_top(self, lines: list[Line], room: int) -> list[Line]:
        self._scrolled["axes"] = min(self._scrolled["axes"], len(lines) - room)
        first = self._scrolled["axes"]
        return lines[first : first + room]

    def _render_many(self, console: Console, options: ConsoleOptions, room: int) -> list[Line]:
        """The summary and the jobs, which stay in sight, and a table of as many controllers as fit below: the work is
        that for what is seen."""
        view = self.view
        ages, permits = view.find_ages(), name_missing_permits(view.queue)
        head = Group(make_fleet_summary(view.states, ages, permits), *view.render_jobs())
        lines = console.render_lines(head, options, pad=False)[:room]
        names = sorted(self._filter_states())
        first = self._scrolled["axes"] = min(self._scrolled["axes"], len(names) - 1)
        places, states = max(0, room - len(lines)), dict[str, ControllerState]()
        rows = itertools.accumulate((len(view.states[name].axes) for name in names[first:]), initial=1)
        for name, row in zip(names[first:], rows, strict=False):
            if row >= places:
                break
            states[name] = view.states[name]
        table = make_state_table(states, view.leases, ages, permits)
        return [*lines, *console.render_lines(table, options, pad=False)[:places]]

    def _cut_events(self, room: int, columns: int) -> list[Line]:
        """The newest matching lines, or older ones if they are scrolled; blank lines above fill the room."""
        found_lines = [line for line in self._lines if self._matches(line)]
        self._scrolled["events"] = min(self._scrolled["events"], max(0, len(found_lines) - room))
        end = len(found_lines) - self._scrolled["events"]
        visible_lines = found_lines[max(0, end - room) : end]
        lines = [Text(line, no_wrap=True, overflow="ellipsis") for line in visible_lines]
        for line in lines:
            line.truncate(columns, overflow="ellipsis")
        blank: list[Line] = [[Segment("")] for _ in range(room - len(lines))]
        return [*blank, *([Segment(line.plain)] for line in lines)]

    def _render_head(self) -> Text:
        silence_text = f"DISCONNECTED: nothing received for {self.connection.silence_s:.0f} s"
        state = ("connected", "green") if self.connection.is_connected else (silence_text, "bold red")
        head = Text.assemble((f"fleet {self.view.keys.fleet}", "bold"), "  ", state, no_wrap=True, overflow="ellipsis")
        if self.view.openness:
            head.append("  INSECURE: the bus has no TLS", "bold red")
        if self.filter or self.is_typing:
            head.append(f"  filter: {self.filter}{'_' if self.is_typing else ''}", "bold yellow")
        if self._scrolled["events"]:
            head.append(f"  {self._scrolled['events']} newer events below", "yellow")
        return head

    def _render_above(self) -> RenderableType:
        view = self.view
        permits = name_missing_permits(view.queue)
        table = make_state_table(self._filter_states(), view.leases, view.find_ages(), permits)
        return Group(table, *view.render_jobs())

    def _render_keys(self) -> Text:
        text = Text(no_wrap=True, overflow="ellipsis")
        for key, meaning in _KEYS:
            mark = " *" if key == "tab" and self._pane == "axes" else ""
            text.append(key, "bold").append(f" {meaning}{mark}   ", "dim")
        return text

    def _filter_states(self) -> Mapping[str, ControllerState]:
        if not self.filter:
            return self.view.states
        states: dict[str, ControllerState] = {}
        for name, state in self.view.states.items():
            axes = {axis: axis_now for axis, axis_now in state.axes.items() if self._matches(f"{name}.{axis}")}
            if axes:
                states[name] = state.model_copy(update={"axes": axes})
        # A filter for events may fit no axis; then all stay in sight.
        return states or self.view.states

    def _matches(self, text: str) -> bool:
        return self.filter.lower() in text.lower()
