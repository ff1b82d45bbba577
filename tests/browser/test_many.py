"""The page of a fleet of hundreds: it asks for the controllers that it shows, and draws no more."""

from typing import Any

import pytest
from browser.conftest import MockedStream
from browser.test_rules import wait_for
from playwright.sync_api import Page, expect

from orchestrator.bench.recording.publisher import make_state
from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.virtual import VirtualClock, VirtualLoop
from orchestrator.gateway.stream.fleet_state import FleetState
from orchestrator.gateway.stream.need import read_need
from orchestrator.model.state import FaultReport

KEYS = FleetKeys("hall")
HOT = FaultReport(code="hot", text="drive too hot", remedy="let it cool")
SHOWN = 24


class Hall(MockedStream):
    """The frames of a fleet of this many controllers, made by the gateway's own state."""

    def __init__(self, page: Page, count: int) -> None:
        self.clock = VirtualClock(VirtualLoop())  # it stands still: nothing becomes old
        self.state = FleetState(KEYS, self.clock)
        self.names = [f"hall-{number:03}" for number in range(count)]
        for name in self.names:
            self.publish(name)
            self.state.take_presence(KEYS.live("controller", name), present=True)
        super().__init__(page, self.state.compose())
        self.replies["names"] = {"controllers": self.names}

    def publish(self, name: str, position: int = 0, **changes: Any) -> None:
        state = make_state(name, position, 0, self.clock.utc(), moving=0)
        axes = {axis: one.model_copy(update={"referenced": True, "enabled": True}) for axis, one in state.axes.items()}
        changed = state.model_copy(update={"mode": "idle", "axes": axes, **changes})
        self.state.take_sample(BusSample(KEYS.state(name), changed.to_json()))

    def _take(self, message: str | bytes) -> None:
        super()._take(message)
        if self.sent[-1]["do"] == "need":
            self._number += 1
            need = read_need(self.sent[-1]["need"])
            self.send({"n": self._number, "state": self.state.compose(need)})

    @property
    def needed(self) -> list[str]:
        """The controllers that the page has asked for last."""
        items = self.find("need")[-1]["need"] if self.find("need") else []
        return [item.removeprefix("controllers/") for item in items if item.startswith("controllers/")]


def find_rows(page: Page) -> list[str]:
    return page.locator("tbody[data-controller]").evaluate_all("all => all.map(each => each.dataset.controller)")


@pytest.fixture
def hall(page: Page) -> Hall:
    hall = Hall(page, 300)
    hall.open()
    wait_for(page, lambda: len(find_rows(page)) == SHOWN)
    return hall


def test_the_controllers_on_screen_are_asked_for_and_drawn_and_the_others_counted(hall: Hall, page: Page) -> None:
    assert sorted(find_rows(page)) == hall.names[:SHOWN] == sorted(hall.needed)
    bar = page.get_by_role("region", name="Controllers that are shown")
    expect(bar).to_contain_text("1 to 24 of 300")
    expect(bar).to_contain_text("300 idle")
    bar.get_by_role("button", name="Controllers after these").click()
    wait_for(page, lambda: sorted(find_rows(page)) == hall.names[SHOWN : 2 * SHOWN])
    bar.get_by_role("searchbox").fill("hall-29")
    wait_for(page, lambda: sorted(find_rows(page)) == hall.names[290:300])
    expect(bar).to_contain_text("1 to 10 of 10, of 300")


def test_what_is_in_trouble_comes_first_and_is_named_wherever_it_is(hall: Hall, page: Page) -> None:
    hall.publish("hall-250", mode="fault", faults=[HOT])
    hall.patch({"counts": dict(hall.state.compose()["counts"])})
    wait_for(page, lambda: "hall-250" in find_rows(page))
    expect(page.get_by_test_id("axis-hall-250.x")).to_contain_text("drive too hot")
    expect(page.get_by_role("status", name="State of the fleet")).to_contain_text("fault: hall-250")
    expect(page.get_by_role("region", name="Messages")).to_contain_text("hall-250")


def test_what_the_page_depends_on_stays_whatever_is_filtered(hall: Hall, page: Page) -> None:
    page.get_by_role("button", name="Plot hall-003.x").click()
    page.get_by_role("searchbox").fill("hall-29")
    wait_for(page, lambda: sorted(find_rows(page)) == hall.names[290:300])
    assert sorted(hall.needed) == ["hall-003", *hall.names[290:300]]
    page.get_by_role("button", name="Set-up").click()
    # What would change with the filter is not chosen by itself, and what is for all is for those on screen.
    expect(page.get_by_role("button", name="Home the 10 shown")).to_be_visible()
    expect(page.get_by_text("Choose an axis in the table.")).to_be_visible()
    page.get_by_role("button", name="hall-295.x", exact=True).click()
    page.get_by_role("searchbox").fill("hall-00")
    wait_for(page, lambda: sorted(find_rows(page)) == hall.names[:10])
    expect(page.get_by_role("region", name="Jog")).to_contain_text("hall-295.x")


def test_a_thousand_controllers_that_all_move_do_not_hold_the_page_up(page: Page) -> None:
    hall = Hall(page, 1000)
    hall.open()
    wait_for(page, lambda: len(find_rows(page)) == SHOWN)
    need = read_need(hall.find("need")[-1]["need"])
    frames: list[dict[str, Any]] = []
    for step in range(40):
        for name in hall.names[:SHOWN]:
            hall.publish(name, position=step)
        frames.append(hall.state.compose(need))
    spent_ms = page.evaluate(
        """frames => {
            const begin = performance.now();
            frames.forEach((state, n) => window.tutti.feed(JSON.stringify({ n, state })));
            return performance.now() - begin;
        }""",
        frames,
    )
    assert spent_ms < 40 * 50  # two seconds of the stream take less than two seconds
    assert len(find_rows(page)) == SHOWN
