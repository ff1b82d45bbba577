"""The screen of the jog panel: everything that an operator needs, at 80 columns, in a terminal of any height."""

import io

import pytest
from rich.console import Console
from unit.controller_states import make_controller_state

from orchestrator.cli.manual.jog.keys import KeyEvent
from orchestrator.cli.manual.jog.panel import JogPanel
from orchestrator.cli.manual.jog.screen import STALE_NS, render_panel
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.state import AxisState, EstopLatch

LIMITS = {"velocity": 200, "acceleration": 1000}


def panel(count: int = 2, releases: bool = True, **more: object) -> JogPanel:
    axis = Axis.model_validate(
        {"motors": ["X"], "unit": "mm", "limits": LIMITS, "soft_limits": {"min": "-1 cm", "max": 400}}
    )
    made = JogPanel({f"gantry.a{k}": axis for k in range(count)}, releases, "lab")
    now = AxisState.model_validate(
        {
            "position": 123.4567,
            "commanded": 0,
            "velocity": -12.5,
            "motor_position": 100,
            "raw_counts": 0,
            "commanded_counts": 0,
            "unit": "mm",
            "moving": False,
            "enabled": True,
            "referenced": True,
            **more,
        }
    )
    state = make_controller_state("gantry", {f"a{k}": now for k in range(count)})
    made.store_state(state, 0)
    return made


def shown(made: JogPanel, now_ns: int = 0, columns: int = 80, rows: int = 24) -> list[str]:
    file = io.StringIO()
    Console(file=file, width=columns, color_system=None).print(render_panel(made, now_ns, columns, rows))
    return [line.rstrip() for line in file.getvalue().splitlines()]


def test_an_axis_with_its_complete_state() -> None:
    row = next(line for line in shown(panel(limit="reverse")) if "▸" in line)
    assert row.split() == ["▸", "gantry.a0", "123.457", "mm", "-12.50", "/s", "on", "yes", "−", "end", "110", "300"]


def test_an_axis_that_is_off_and_unreferenced() -> None:
    lines = shown(panel(enabled=False, referenced=False))
    row = next(line for line in lines if "▸" in line)
    assert row.split()[6:] == ["off", "no", "?", "?"]
    assert any("of 4 mm/s, slow: unreferenced" in line for line in lines)


def test_a_silent_controller_is_not_shown_as_current() -> None:
    lines = shown(panel(), STALE_NS + 1)
    assert "silent" in next(line for line in lines if "▸" in line)
    assert any("no state received for 2 s" in line for line in lines)


def test_refusals_and_estops_with_their_remedies() -> None:
    made = panel()
    latch = EstopLatch(event="e", actor="ann", reason="hand in the machine", utc="")
    made.store_state(made.states["gantry"].model_copy(update={"estop": latch}), 0)
    made.handle_lease_lost(Refusal("leased", "gantry.a0 is in use by bob", "ask them"))
    text = "\n".join(shown(made))
    assert "E-STOP by ann: hand in the machine → `tutti reset` when it is safe" in text
    assert "refused: gantry.a0 is in use by bob (leased) → ask them" in text


def test_it_shows_what_letting_go_means_on_this_terminal() -> None:
    assert any("Releases are reported" in line for line in shown(panel()))
    assert any("within 120" in line for line in shown(panel(releases=False)))


@pytest.mark.parametrize("rows", [16, 24, 60])
def test_the_chosen_axis_and_the_keys_are_always_in_sight(rows: int) -> None:
    made = panel(count=40)
    for _ in range(25):
        made.handle_key(KeyEvent("down"), NS_PER_S)
    lines = shown(made, rows=rows)
    assert len(lines) <= rows
    assert any("▸ gantry.a25" in line for line in lines)
    assert any("e-stop" in line for line in lines)
    assert all(len(line) <= 80 for line in lines)


def test_the_sizes_of_a_step_and_the_keys_are_shown() -> None:
    made = panel()
    made.handle_key(KeyEvent("tab"), NS_PER_S)
    text = "\n".join(shown(made))
    assert "arrows  hold [0.01] 0.1  1  10  mm" in text
    for keys in ("space esc stop", "s stop the fleet", "x e-stop", "e enable", "h h home", "z z zero", "tab step size"):
        assert keys in text
    made.handle_key(KeyEvent("e"), NS_PER_S)
    assert "enable gantry.a0" in "\n".join(shown(made))
