"""Virtual axes on the page: rows behind the real ones, with the same buttons, and jogs of their real axes."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser.conftest import MockedStream, PageFleet, find_address, make_axis, make_state
from browser.test_rules import wait_for
from children import wait_until
from fleet import EXAMPLES, RunningFleet
from playwright.sync_api import Page, expect

from orchestrator.clock.live import raw_ns
from orchestrator.model.jobs.files import load_fleet

Mock = Callable[..., MockedStream]
JOG_MOST_NS = 1_500_000_000  # the common ramp down in steps, besides what a real axis takes


def make_group(obstacle: str = "", **fields: Any) -> dict[str, Any]:
    axis = make_axis(jog_velocity=2.0, min=-5.0, max=30.0, **fields)
    for name in ("max_velocity", "manual_speed", "homing", "limit", "offset"):
        del axis[name]
    if obstacle:
        axis |= {"fault": obstacle}
    return {
        "mode": "idle",
        "present": True,
        "age_s": 0,
        "make": "slit of gantry.x, gantry.y",
        "of": ["gantry.x", "gantry.y"],
        "faults": [],
        "axes": {"gap": axis, "centre": {**axis, "jog_velocity": 0}},
    }


def with_slit(**fields: Any) -> dict[str, Any]:
    return make_state(virtual={"slit": make_group(**fields)})


def test_virtual_axes_are_rows_behind_the_real_ones(mock: Mock, page: Page) -> None:
    stream = mock(with_slit())
    table = page.get_by_role("region", name="Axes", exact=True)
    expect(table.locator("tbody").last).to_contain_text("slit of gantry.x, gantry.y")
    expect(page.get_by_test_id("position-slit.gap")).to_have_text("12.500 mm")
    stream.patch({"virtual": {"slit": {"axes": {"gap": {"position": 3.25, "fault": "gantry.y: following error"}}}}})
    expect(page.get_by_test_id("position-slit.gap")).to_have_text("3.250 mm")
    expect(page.get_by_test_id("axis-slit.gap")).to_contain_text("gantry.y: following error")
    # They need nothing of their own: motors and references are those of the real axes.
    page.get_by_role("button", name="Set-up").click()
    expect(page.get_by_role("region", name="Get ready")).to_contain_text("2 of 2")
    stream.patch({"virtual": None})
    expect(page.get_by_test_id("axis-slit.gap")).to_have_count(0)


def test_a_virtual_axis_is_moved_and_its_real_axes_are_homed(mock: Mock, page: Page) -> None:
    stream = mock(with_slit())
    page.get_by_role("button", name="Go: slit.gap").click()
    dialog = page.get_by_role("dialog", name="Move slit.gap")
    expect(dialog).to_contain_text("soft limits -5.000 mm … 30.000 mm")
    dialog.get_by_label("Position in mm").fill("31")
    expect(dialog).to_contain_text("30.000 mm")
    dialog.get_by_label("Position in mm").fill("20")
    dialog.get_by_role("button", name="Go to 20.000 mm").click()
    wait_for(page, lambda: stream.find("work"))
    assert stream.find("work")[0]["step"] == {"do": "move", "to": {"slit.gap": 20}, "speed": 0.2}
    stream.send({"work": {"id": stream.find("work")[0]["id"], "state": "done"}})
    page.get_by_role("button", name="Menu of slit.gap").click()
    menu = page.get_by_role("dialog")
    expect(menu).to_contain_text("those of gantry.x, gantry.y")
    expect(menu.get_by_label("Position in mm")).to_have_count(0)
    menu.get_by_role("button", name="Home slit.gap").click()
    wait_for(page, lambda: len(stream.find("work")) == 2)
    assert stream.find("work")[1]["step"] == {"do": "home", "axes": ["gantry.x", "gantry.y"]}


def test_a_virtual_axis_that_cannot_be_jogged_says_so(mock: Mock, page: Page) -> None:
    stream = mock(with_slit(), view="setup")
    page.get_by_label("Left and right").select_option("slit.gap")
    page.get_by_label("Up and down").select_option("slit.centre")
    button = page.get_by_role("button", name="Jog slit.centre +", exact=True)
    expect(button).to_have_attribute(
        "aria-description", "slit.centre cannot be jogged now: its real axes cannot, or it would leave its curve"
    )
    page.get_by_role("button", name="Jog slit.gap +", exact=True).click(delay=300)
    wait_for(page, lambda: stream.find("end-jog"))
    assert stream.find("acquire") == [{"do": "acquire", "axes": ["slit.gap"], "id": stream.find("acquire")[0]["id"]}]
    assert stream.find("jog")[0]["velocity"] == 0.4  # a fifth of 2 mm/s


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningFleet]:
    """The demo fleet, with axes that are turned by 30 degrees against those of its gantry."""
    folder = tmp_path_factory.mktemp("turned")
    plain = load_fleet(EXAMPLES / "demo.fleet.yaml").to_plain()
    axes = {"u": {"unit": "mm"}, "v": {"unit": "mm"}}
    plain["virtual"] = {"turned": {"kind": "rotation", "of": ["gantry.x", "gantry.y"], "axes": axes, "angle": 30}}
    path = Path(folder, "turned.fleet.json")
    path.write_text(json.dumps(plain))
    fleet = PageFleet(folder, path, web=True)
    try:
        fleet.started().ready()
        assert fleet.run([{"do": "move", "to": {"gantry.x": 100, "gantry.y": 100}}]).state == "done"
        yield fleet
    finally:
        fleet.close()


def test_a_jog_of_a_virtual_axis_moves_its_real_axes_and_ends_when_it_is_let_go(
    page: Page, turned: RunningFleet
) -> None:
    page.goto(f"{find_address(turned)}#setup")
    page.get_by_label("Left and right").select_option("turned.u")
    first = page.get_by_test_id("position-turned.v").inner_text()
    button = page.get_by_role("button", name="Jog turned.u +", exact=True)
    expect(button).not_to_have_attribute("aria-disabled", "true")
    count = turned.starts("gantry")
    button.hover()
    page.mouse.down()
    wait_for(page, lambda: turned.starts("gantry") >= count + 2)
    page.wait_for_timeout(1000)
    let_go_ns = raw_ns()
    page.mouse.up()
    wait_until(lambda: all(entry["event"] == "end" for entry in last_events(turned)), "both axes are at rest")
    assert max(entry["end_ns"] for entry in last_events(turned)) - let_go_ns < JOG_MOST_NS
    assert float(page.get_by_test_id("position-turned.v").inner_text().split()[0]) == pytest.approx(
        float(first.split()[0]), abs=0.05
    )
    expect(page.get_by_role("region", name="Messages").get_by_text("turned")).to_have_count(0)


def last_events(fleet: RunningFleet) -> list[dict[str, Any]]:
    """The last event of each axis of the gantry."""
    last = {entry["axis"]: entry for entry in fleet.truth("gantry") if "axis" in entry}
    return list(last.values())
