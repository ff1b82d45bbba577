"""A fleet of many controllers in few lines."""

from io import StringIO
from typing import Any

import pytest
from rich.console import Console
from unit.controller_states import make_controller_state

from orchestrator.model.state import AxisState, ControllerState, EstopLatch, FaultReport
from orchestrator.model.text.name_patterns import check_pattern, select_names
from orchestrator.monitor.fleet_summary import MAX_NAMED, make_fleet_summary

AXIS = AxisState(
    position=0, commanded=0, velocity=0, motor_position=0, raw_counts=0, commanded_counts=0, unit="mm", moving=False,
    enabled=True, referenced=True,
)  # fmt: skip
HOT = FaultReport(code="hot", text="drive too hot", remedy="let it cool")


def make_state(name: str, **changes: Any) -> ControllerState:
    """A controller that is at rest and sound, but for `changes` of it, or of its `axis`."""
    axis = AXIS.model_copy(update=changes.pop("axis", {}))
    return make_controller_state(name, {"x": axis}).model_copy(update=changes)


def summary(*states: ControllerState, **more: Any) -> list[str]:
    console = Console(width=500, file=StringIO(), record=True)
    console.print(make_fleet_summary({state.controller: state for state in states}, **more))
    return console.export_text().splitlines()


def test_what_is_at_rest_and_sound_is_counted_and_all_else_is_named() -> None:
    sound = [make_state(f"hall-{number:03}") for number in range(200)]
    cases: dict[str, dict[str, Any]] = {
        "1 fault: odd (drive too hot)": {"faults": [HOT]},
        "1 offline: odd": {"mode": "offline"},
        "1 limit: odd": {"axis": {"limit": "forward"}},
        "1 e-stop: odd (hand)": {"estop": EstopLatch(event="e", actor="anna", reason="hand", utc="")},
        "1 moving: odd": {"mode": "moving"},
        "1 under manual control: odd": {"leases": {"x": "manual-1"}},
        "1 off: odd": {"axis": {"enabled": False}},
        "1 unreferenced: odd": {"axis": {"referenced": False}},
    }
    for line, changes in cases.items():
        head, *lines = summary(*sound, make_state("odd", **changes))
        assert head.startswith("201 controllers: 20"), head
        assert lines == [line]
    assert summary(*sound, ages={"hall-007": 3.0})[1:] == ["1 silent: hall-007"]
    assert summary(*sound, permits={"hall-007.x": "laser"})[1:] == ["1 without a permit: hall-007"]
    assert summary(*sound) == ["200 controllers: 200 idle"]


def test_many_of_one_kind_are_cut_and_the_worst_come_first() -> None:
    moving = [make_state(f"m-{number:03}", mode="moving") for number in range(900)]
    faulty = [make_state(f"f-{number:03}", faults=[HOT]) for number in range(100)]
    head, *lines = summary(*moving, *faulty)
    assert head == "1,000 controllers: 900 moving, 100 fault"
    assert [line.partition(":")[0] for line in lines] == ["100 fault", "900 moving"]
    assert lines[0].count("f-") == MAX_NAMED and lines[0].endswith("and 92 more")


def test_patterns_choose_names_and_what_is_none_is_refused() -> None:
    names = ["hall-1", "hall-10", "hall-2", "a.x", "b.x"]
    assert select_names(["hall-1*", "b.x", "nothing"], names) == ["hall-1", "hall-10", "b.x"]
    assert select_names(["*.x"], names) == ["a.x", "b.x"]
    assert select_names([], names) == []
    assert select_names(["*a" * 60 + "*"], ["a" * 59]) == []  # at once: nothing is tried again and again
    assert check_pattern("*") == "*"
    for text in ("", "A", "hall-[12]", "a b", "x" * 200):
        with pytest.raises(ValueError, match="for example hall-1"):
            check_pattern(text)
