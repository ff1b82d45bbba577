"""The screen of `tutti watch`: it fills the height, scrolls, filters, and says whether it is connected."""

from collections.abc import Mapping
from typing import Any

import pytest
from rich.console import Console, RenderableType

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.cli.manual.jog.keys import KeyEvent, KeyParser
from orchestrator.cli.view.watch import panel as panel_module
from orchestrator.cli.view.watch.panel import WatchPanel
from orchestrator.model.operation.alarms import OPEN_BUS, AlarmRecord
from orchestrator.model.state import AxisState, ControllerEvent, ControllerState, FaultReport
from orchestrator.monitor.fleet_view import LiveView

KEYS = FleetKeys("lab")
AXIS = AxisState(
    position=1.5, commanded=1.5, velocity=0, motor_position=1.5, raw_counts=1500, commanded_counts=1500, unit="mm",
    moving=False, enabled=True, referenced=True,
)  # fmt: skip


def make_state(controller: str, *axes: str, faults: tuple[str, ...] = ()) -> BusSample:
    said = ControllerState(
        controller=controller, instance="i", seq=1, utc="2026-01-01T00:00:00Z", fleet_ns=0, mode="idle",
        axes=dict.fromkeys(axes, AXIS), inputs={}, outputs={}, clock=None, estop=None, epoch=1, digest="d",
        faults=[FaultReport(code="c", text=text, remedy="look") for text in faults],
    )  # fmt: skip
    return BusSample(KEYS.state(controller), said.to_json())


def make_event(number: int, controller: str = "gantry") -> BusSample:
    said = ControllerEvent(
        controller=controller, instance="i", seq=number, utc="2026-01-01T00:00:00Z", fleet_ns=0, kind="online",
        text=f"number {number}",
    )  # fmt: skip
    return BusSample(KEYS.event(controller), said.to_json())


class Watcher:
    """A panel, with its time."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.panel = WatchPanel(LiveView(KEYS, lambda: self.now_s), lambda: self.now_s, lambda: "2026-01-01T00:00:00Z")
        self.take(make_state("gantry", "x", "y"), make_state("stage", "u"))

    def take(self, *samples: BusSample) -> None:
        for sample in samples:
            self.panel.take_sample(sample)

    def press(self, *names: str) -> bool:
        return [self.panel.handle_key(KeyEvent(name)) for name in names][-1]

    def pass_time(self, duration_s: float) -> None:
        self.now_s += duration_s
        self.panel.check_time()

    def lines(self, columns: int = 80, rows: int = 24) -> list[str]:
        self.panel.rows = rows
        console = Console(width=columns, height=rows, color_system=None)
        with console.capture() as drawn:
            console.print(self.panel, width=columns, end="")
        return [line.rstrip() for line in drawn.get().splitlines()]


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (40, 15), (200, 60), (80, 8)])
def test_the_whole_height_is_used_and_no_more(columns: int, rows: int) -> None:
    watcher = Watcher()
    assert len(watcher.lines(columns, rows)) == rows
    watcher.take(*(make_event(number) for number in range(100)))
    lines = watcher.lines(columns, rows)
    assert len(lines) == rows
    assert max(map(len, lines)) <= columns
    assert lines[0] == "fleet lab  connected"
    assert ("number 99" if columns >= 80 else "gantry: online") in lines[-2]
    assert lines[-1].startswith("↑/↓ PgUp/PgDn scroll")


def test_an_open_bus_is_in_the_first_line_as_long_as_it_is_open() -> None:
    watcher = Watcher()
    for state, shown in (("unacknowledged", True), ("acknowledged", True), ("returned", False)):
        alarm = AlarmRecord(
            id="open-bus-bus", kind=OPEN_BUS, subject="bus", priority="high", text="INSECURE: it has no TLS", action="",
            state=state, raised_utc="2026-01-01T00:00:00Z",
        )  # fmt: skip
        watcher.take(BusSample(KEYS.alarm(alarm.id), alarm.to_json()))
        assert ("INSECURE: the bus has no TLS" in watcher.lines()[0]) == shown


def test_events_scroll_and_stay_where_they_are_read() -> None:
    watcher = Watcher()
    watcher.take(*(make_event(number) for number in range(100)))
    watcher.press("pageup", "up")
    assert "number 88" in watcher.lines()[-2]
    assert "11 newer events below" in watcher.lines()[0]
    watcher.take(make_event(100))
    assert "number 88" in watcher.lines()[-2]
    watcher.press("pagedown", "pagedown")
    assert "number 100" in watcher.lines()[-2]
    watcher.press(*["pageup"] * 50)
    assert "number 0" in "\n".join(watcher.lines())
    watcher.press("escape")
    assert "number 100" in watcher.lines()[-2]


def test_axes_scroll_where_they_do_not_fit() -> None:
    watcher = Watcher()
    watcher.take(make_state("wall", *(f"a{number:02}" for number in range(50))))
    assert "a49" not in "\n".join(watcher.lines())
    watcher.press("tab", *["pagedown"] * 9)
    shown = "\n".join(watcher.lines())
    assert "a49" in shown and "axes or events *" in shown


def test_a_filter_is_for_axes_and_events() -> None:
    watcher = Watcher()
    watcher.take(make_event(1, "gantry"), make_event(2, "stage"))
    watcher.press("/", *"gantr", "x", "backspace", "y", "enter")
    shown = "\n".join(watcher.lines())
    assert "filter: gantry" in shown and "number 1" in shown
    assert "number 2" not in shown and "stage" not in shown
    assert not watcher.press("/", "q")
    assert watcher.press("enter", "q")
    watcher.press("/", "escape")
    assert "number 2" in "\n".join(watcher.lines())


def test_it_says_when_it_is_disconnected_and_connected_again() -> None:
    watcher = Watcher()
    watcher.take(make_state("gantry", "x", faults=("does not answer",)))
    assert "gantry: does not answer → look" in watcher.lines()
    watcher.pass_time(1.0)
    assert "connected" in watcher.lines()[0]
    watcher.pass_time(11.0)
    shown = watcher.lines()
    assert shown[0] == "fleet lab  DISCONNECTED: nothing received for 12 s"
    assert "gantry, 12 s ago: does not answer → look" in shown
    assert "disconnected: nothing received for 12.0 s" in shown[-2]
    watcher.pass_time(1.0)
    assert sum("disconnected" in line for line in watcher.lines()) == 1
    watcher.take(make_state("gantry", "x", "y"))
    shown = watcher.lines()
    assert shown[0] == "fleet lab  connected"
    assert "connected again after 13 s" in shown[-2]
    assert "does not answer" not in "\n".join(shown)


def test_paging_keys_are_parsed() -> None:
    assert KeyParser().parse_bytes(b"\x1b[5~\x1b[6~\x1b[3~") == [KeyEvent("pageup"), KeyEvent("pagedown")]


def test_of_a_thousand_controllers_those_in_sight_are_drawn_below_a_summary(monkeypatch: pytest.MonkeyPatch) -> None:
    watcher = Watcher()
    watcher.take(*(make_state(f"hall-{n:04}", *"xyzw", faults=("too hot",) if n == 517 else ()) for n in range(1000)))
    drawn: list[int] = []
    make_table = panel_module.make_state_table

    def count_drawn(states: Mapping[str, ControllerState], *more: Any) -> RenderableType:
        drawn.append(len(states))
        return make_table(states, *more)

    monkeypatch.setattr(panel_module, "make_state_table", count_drawn)
    lines = watcher.lines()
    assert len(lines) == 24
    assert lines[1:3] == ["1,002 controllers: 1,001 idle, 1 fault", "1 fault: hall-0517 (too hot)"]
    watcher.press("tab", *["pagedown"] * 200)
    assert any(line.startswith("stage") for line in watcher.lines())  # the last one; the summary stays
    assert "hall-0517" in watcher.lines()[2]
    watcher.press("/", *"hall-0123", "enter")
    assert sum(line.startswith("hall-") for line in watcher.lines()) == 1
    assert max(drawn) < 10
