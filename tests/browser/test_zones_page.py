"""The keep-out zones on the page: in space, in the XY view, and what their rules say."""

from pathlib import Path

from browser.conftest import make_axis, make_controller, make_state
from browser.test_rules import Mock
from playwright.sync_api import Locator, Page, expect

from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.operation.zone_state import ZoneState
from orchestrator.plan.zones.observation import observe_zones
from orchestrator.plan.zones.rules import FleetZones

FLEET = load_fleet(Path(__file__).parents[2] / "deploy" / "examples" / "zones.fleet.yaml")
AXES = {"gantry": ("x", "z"), "stage": ("u", "phi")}
STATE = make_state(
    controllers={
        controller: make_controller({name: make_axis(position=0.0, unit="mm") for name in names}, id=controller)
        for controller, names in AXES.items()
    }
)


def observe(unknown: dict[str, str] | None = None, **positions: float) -> ZoneState:
    zones = FleetZones(FLEET)
    causes = unknown or {}
    standing = {f"{controller}.{name}": 0.0 for controller, names in AXES.items() for name in names}
    moved = {name.replace("_", "."): position for name, position in positions.items()}
    known = {name: position for name, position in {**standing, **moved}.items() if name not in causes}
    return observe_zones(FLEET, zones, known, causes)


def open_zones(page: Page) -> Locator:
    page.get_by_role("button", name="Zones").first.click()
    return page.get_by_role("region", name="Zones")


def test_a_fleet_without_zones_has_no_view_of_them(mock: Mock, page: Page) -> None:
    mock(STATE, replies={"zones": ZoneState().to_plain()})
    expect(page.get_by_role("button", name="XY view")).to_be_visible()
    expect(page.get_by_role("button", name="Zones")).to_have_count(0)


def test_rules_say_how_far_bodies_are_apart_and_what_is_broken_is_marked(mock: Mock, page: Page) -> None:
    stream = mock(STATE, replies={"zones": observe(gantry_x=150, stage_phi=30).to_plain()})
    region = open_zones(page)
    expect(region).to_contain_text("6.34 mm, at least 5.00")
    expect(region).to_contain_text("Zones are software, no safety function.")
    space = region.get_by_role("img")
    expect(space.locator(".zonebody")).to_have_count(3)
    expect(space.locator(".region")).to_have_count(1)
    expect(space.locator(".broken")).to_have_count(0)
    stream.replies["zones"] = observe(gantry_x=158, stage_phi=50).to_plain()
    expect(space.locator(".zonebody.broken")).to_have_count(2)
    expect(page.get_by_role("button", name="Zones: a rule is broken")).to_be_visible()
    expect(region.get_by_role("listitem").filter(has_text="low-detector")).to_contain_text("▲")


def test_an_axis_that_is_not_known_is_said_and_its_body_is_dashed(mock: Mock, page: Page) -> None:
    mock(STATE, replies={"zones": observe({"stage.phi": "not referenced"}).to_plain()})
    region = open_zones(page)
    expect(region.get_by_role("listitem").filter(has_text="low-detector")).to_contain_text("an axis may be anywhere")
    expect(region.locator(".zonebody.anywhere")).to_have_count(1)


def test_the_picture_is_turned_by_keys_and_by_the_pointer(mock: Mock, page: Page) -> None:
    mock(STATE, replies={"zones": observe().to_plain()})
    space = open_zones(page).get_by_role("img")
    outline = space.locator(".zonebody polygon").first

    def look() -> str:
        return outline.get_attribute("points") or ""

    first_look = look()
    space.press("ArrowLeft")
    expect(outline).not_to_have_attribute("points", first_look)
    turned_look = look()
    box = space.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 60, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 120, box["y"] + 60)
    page.mouse.up()
    expect(outline).not_to_have_attribute("points", turned_look)
    page.get_by_role("button", name="Reset view").click()
    expect(outline).to_have_attribute("points", first_look)


def test_the_xy_view_has_the_bodies_where_its_axes_are(mock: Mock, page: Page) -> None:
    mock(STATE, replies={"zones": observe(gantry_x=100).to_plain()})
    page.get_by_role("button", name="XY view").first.click()
    view = page.get_by_role("region", name="XY view")
    view.get_by_label("Axis upwards").select_option("gantry.z")
    expect(view.locator(".shadows .zonebody")).to_have_count(3)
    expect(view.locator(".shadows .region")).to_have_count(1)
    view.get_by_label("Axis upwards").select_option("stage.phi")  # it turns: there is no plane
    expect(view.locator(".shadows")).to_have_count(0)
