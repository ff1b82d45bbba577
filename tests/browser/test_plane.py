"""Two axes in their plane, live: where they have been, are, and go."""

from typing import Any

from browser.conftest import LARGE, make_axis, make_controller, make_state
from browser.test_rules import Mock, wait_for
from browser.test_starts import make_fleet, make_refusal
from playwright.sync_api import Locator, Page, expect


def open_plane(page: Page) -> Locator:
    page.get_by_role("button", name="XY view").first.click()
    return page.get_by_role("region", name="XY view")


def count_points(region: Locator, kind: str) -> int:
    lines = region.locator(f"polyline.{kind}")
    return len((lines.first.get_attribute("points") or "").split()) if lines.count() else 0


def test_the_view_takes_no_room_until_it_is_shown_and_its_choice_is_remembered(mock: Mock, page: Page) -> None:
    axes = {name: make_axis(position=n) for n, name in enumerate(("x", "y", "z"))}
    state = make_state(controllers={"gantry": make_controller(axes)})
    mock(state)
    expect(page.get_by_role("region", name="XY view")).to_have_count(0)
    assert page.locator(".pictures").bounding_box() in (None, {"x": 0, "y": 0, "width": 0, "height": 0})
    region = open_plane(page)
    region.get_by_label("Axis upwards").select_option("gantry.z")
    expect(region.get_by_role("img")).to_have_accessible_name("gantry.x at 0.000 mm, gantry.z at 2.000 mm")
    region.get_by_label("Axis to the right").select_option("gantry.z")  # both at once: they change places
    expect(region.get_by_role("img")).to_have_accessible_name("gantry.z at 2.000 mm, gantry.x at 0.000 mm")
    page.reload()
    expect(page.get_by_role("region", name="XY view").get_by_label("Axis upwards")).to_have_value("gantry.x")
    page.get_by_role("button", name="Hide the XY view").click()
    expect(page.get_by_role("region", name="XY view")).to_have_count(0)


def test_it_shows_where_the_axes_have_been_and_are(mock: Mock, page: Page) -> None:
    stream = mock()
    region = open_plane(page)
    expect(region.locator("rect.limits")).to_be_visible()
    here = region.locator(".here circle")
    left = float(here.get_attribute("cx") or 0)
    frames = 0

    def move_on() -> bool:
        nonlocal frames
        frames += 1
        position = {"position": 12.5 + 10 * frames}
        stream.patch({"controllers": {"gantry": {"axes": {"x": position, "y": {"position": 3.25 + frames}}}}})
        return count_points(region, "trail") >= 6

    wait_for(page, move_on)
    assert float(here.get_attribute("cx") or 0) > left
    expect(region.locator("rect.target")).to_have_count(0)  # nothing is under way


def test_a_move_of_several_axes_is_shown_up_to_its_target(mock: Mock, page: Page) -> None:
    stream = mock()
    region = open_plane(page)
    moves = {"moving": True, "target": 100.0}
    stream.patch({"controllers": {"gantry": {"axes": {"x": moves, "y": {**moves, "target": 50.0}}}}})
    expect(region.locator("rect.target")).to_be_visible()
    assert count_points(region, "ahead") == 2
    stopped = {"moving": False, "target": None}
    stream.patch({"controllers": {"gantry": {"axes": {"x": stopped, "y": stopped}}}})
    expect(region.locator("rect.target")).to_have_count(0)


def make_path() -> dict[str, Any]:
    times = [0.0, 1.0, 2.0]
    axes = {f"gantry.{name}": {"unit": "mm", "t": times, "v": v} for name, v in (("x", [0, 9, 9]), ("y", [0, 0, 9]))}
    return {"duration_s": 2, "steps": [], "axes": axes, "unknown": None}


def test_the_path_of_the_running_step_is_ahead_and_gone_after_it(mock: Mock, page: Page) -> None:
    stream = mock(replies={"jobs/id-r/path/3": make_path()})
    region = open_plane(page)
    stream.patch({"paths": {"id-r": {"step": 3, "axes": ["gantry.x", "gantry.y"]}}})
    wait_for(page, lambda: count_points(region, "ahead") > 100)
    stream.patch({"paths": {"id-r": None}})
    expect(region.locator("polyline.ahead")).to_have_count(0)


def test_a_path_of_other_axes_and_one_that_is_refused_are_not_drawn(mock: Mock, page: Page) -> None:
    stream = mock(replies={"jobs/id-r/path/4": make_refusal("no-path", "it is none"), "jobs/id-r/path/3": make_path()})
    region = open_plane(page)
    stream.patch({"paths": {"id-r": {"step": 3, "axes": ["gantry.x", "stage.u"]}}})
    stream.patch({"paths": {"id-r": {"step": 4, "axes": ["gantry.x", "gantry.y"]}}})
    page.wait_for_timeout(300)
    expect(region.locator("polyline.ahead")).to_have_count(0)
    expect(region.locator(".here")).to_be_visible()


def test_without_soft_limits_there_is_no_frame(mock: Mock, page: Page) -> None:
    axes = {"x": make_axis(), "y": make_axis()}
    del axes["y"]["min"]
    mock(make_state(controllers={"gantry": make_controller(axes)}))
    region = open_plane(page)
    expect(region.locator(".here")).to_be_visible()
    expect(region.locator("rect.limits")).to_have_count(0)


def test_with_plots_and_twelve_axes_what_moves_is_still_above_every_inner_edge(mock: Mock, page: Page) -> None:
    page.set_viewport_size(LARGE)
    stream = mock(make_state(controllers=make_fleet()))
    open_plane(page)
    page.get_by_role("button", name="Plot c1.x").click()
    moving = {"mode": "moving", "axes": {"x": {"moving": True}, "y": {"moving": True}}}
    stream.patch({"controllers": {"c5": moving, "c6": moving}})
    page.mouse.move(5, 5)
    for axis in ("c5.x", "c5.y", "c6.x", "c6.y"):
        expect(page.get_by_test_id(f"axis-{axis}")).to_be_in_viewport(ratio=1)
    assert page.evaluate("document.documentElement.scrollHeight <= innerHeight")
