"""Parts of the page that a fleet has or has not, all at once: legible for everyone, and within the screen."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import pytest
from browser.conftest import LARGE, MAY, SMALL, MockedStream, make_state
from browser.test_buttons import TEMPLATES
from browser.test_cameras import IMAGE, SIDE, answer
from browser.test_console import RAW, TRACE
from browser.test_gamepad import PAD
from playwright.sync_api import Page, ViewportSize, expect

Mock = Callable[..., MockedStream]

AXE = Path(__file__).parents[2] / "orchestrator" / "gateway" / "page" / "node_modules" / "axe-core" / "axe.min.js"
VIEWS = ("run", "setup", "service")


def open_everything(mock: Mock, page: Page, view: str) -> None:
    page.add_init_script(PAD)
    answer(page)
    replies = {"templates": {"templates": TEMPLATES}, "trace/gantry": TRACE, RAW: {"refused": None, "reply": "7"}}
    rights: dict[str, Any] = {"role": "maintainer", "may": [*MAY, "raw"], "users": True, "user": "mia", "csrf": "x"}
    mock(make_state(views=[IMAGE, SIDE]), view=view, replies=replies, **rights)
    if view == "service":
        panel = page.get_by_role("region", name="Console")
        panel.get_by_role("checkbox").check()
        panel.get_by_role("textbox").fill("MG TIME")
        panel.get_by_role("textbox").press("Enter")
        expect(panel.get_by_role("log", name="Commands and replies")).to_be_visible()
        return
    expect(page.get_by_role("region", name="Buttons")).to_be_visible()
    expect(page.get_by_role("img", name="From above")).to_be_visible()
    if view == "setup":
        page.get_by_role("button", name="Use a gamepad").click()
        expect(page.get_by_role("meter", name="Up and down")).to_be_visible()


@pytest.mark.parametrize("colours", ["light", "dark"])
@pytest.mark.parametrize("view", VIEWS)
def test_axe_finds_no_serious_fault(mock: Mock, page: Page, view: str, colours: Literal["light", "dark"]) -> None:
    page.emulate_media(color_scheme=colours)
    open_everything(mock, page, view)
    page.evaluate(AXE.read_text())
    violations = page.evaluate("axe.run({iframes: false}).then(result => result.violations)")
    serious = [violation for violation in violations if violation["impact"] in ("serious", "critical")]
    assert not serious, [
        (violation["id"], [node["html"][:120] for node in violation["nodes"]][:3]) for violation in serious
    ]


@pytest.mark.parametrize("size", [SMALL, LARGE])
@pytest.mark.parametrize("view", VIEWS)
def test_nothing_is_wider_than_the_screen(mock: Mock, page: Page, view: str, size: ViewportSize) -> None:
    page.set_viewport_size(size)
    open_everything(mock, page, view)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    if size == LARGE and view == "run":
        assert page.evaluate("document.documentElement.scrollHeight <= innerHeight")
