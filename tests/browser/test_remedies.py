"""Remedies name what is on the page, and what they name is there."""

from typing import Any

from browser.conftest import make_axis, make_controller, make_state
from browser.test_rules import Mock, wait_for
from playwright.sync_api import Page, expect


def make_fault(**fields: Any) -> dict[str, Any]:
    fault = {
        "code": "f",
        "text": "the drive reports 0x2310",
        "remedy": "remove its cause, then clear it with `tutti reset`",
    }
    return make_controller({"x": make_axis()}, mode="fault", faults=[fault], **fields)


def test_a_fault_without_an_estop_has_the_reset_that_its_remedy_names(mock: Mock, page: Page) -> None:
    stream = mock(make_state(controllers={"gantry": make_fault()}), replies={"reset": {"answers": {"gantry": None}}})
    expect(page.get_by_test_id("axis-gantry.x")).to_contain_text("remove its cause, then clear it with Reset")
    page.get_by_role("region", name="Messages").get_by_role("button", name="Reset").click()
    wait_for(page, lambda: [name for name, _ in stream.asked] == ["reset"])
    expect(page.get_by_text("Reset: E-stops are released, and faults cleared").first).to_be_visible()


def test_with_an_estop_there_is_one_reset(mock: Mock, page: Page) -> None:
    estop = {"event": "e", "actor": "anna", "reason": "", "utc": "2026-01-01T00:00:00Z"}
    mock(make_state(controllers={"gantry": make_fault(estop=estop)}))
    expect(page.get_by_role("button", name="Reset")).to_have_count(1)


def test_a_refusal_names_the_page_and_never_a_command_line(mock: Mock, page: Page) -> None:
    far = {
        **{"name": "far", "axes": {"gantry.x": "4 mm"}, "source": "saved"},
        "problems": ["no axis gantry.q; save it again, or remove it: `tutti position save`, `tutti position rm`"],
    }
    stream = mock(view="setup", replies={"positions": {"positions": [far]}})
    expect(page.get_by_text("save it again, or remove it: Named positions, in Set-up").first).to_be_visible()
    remedies = {
        "pause it at the end of the path (without --now), or stop it: `tutti stop`": "Pause after this step; or stop it: Stop",
        "end `tutti up` and start it with the new file": "have the fleet ended, and started with the new file",
        "see `tutti new-command --of a later release`": "see the terminal of the computer of the fleet",
    }
    for remedy, words in remedies.items():
        stream.answers["work"] = {"refused": {"code": "leased", "text": "no", "remedy": remedy}}
        page.get_by_role("button", name="Menu of gantry.x").click()
        page.get_by_role("button", name="Disable gantry.x").click()
        expect(page.get_by_role("region", name="Messages")).to_contain_text(words)
    expect(page.get_by_text("`tutti")).to_have_count(0)
