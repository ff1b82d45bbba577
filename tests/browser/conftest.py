"""A real browser, headless, and a demo fleet with its page. `make test-browser` runs these tests."""

import json
import shutil
import sys
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "live"))  # the fleets of the live tests

from children import LIMIT_S
from fleet import RunningFleet
from playwright.sync_api import Browser, BrowserContext, Page, ViewportSize, WebSocketRoute, sync_playwright

from benches.page.frames import HELLO
from orchestrator.client.api import Tutti
from orchestrator.gateway.app import PAGE

T = TypeVar("T")

NAMES = ("chromium", "chromium-browser", "google-chrome")
LARGE: ViewportSize = {"width": 1280, "height": 800}
SMALL: ViewportSize = {"width": 390, "height": 844}
MOCKED = "http://page.test/"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All of them need a browser."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.browser)


def find_program() -> str:
    """The browser's program."""
    found = [path for path in map(shutil.which, NAMES) if path]
    if not found:
        pytest.exit("no browser is installed; on Debian: apt-get install chromium", 2)
    return found[0]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if not (PAGE / "page.js").is_file():
        pytest.exit("the page is not built: make page", 2)
    with sync_playwright() as playwright:
        # A mocked page has no address, and is taken for one of the internet, which may not load from this computer.
        options = ["--no-sandbox", "--disable-features=LocalNetworkAccessChecks"]
        browser = playwright.chromium.launch(executable_path=find_program(), args=options)
        yield browser
        browser.close()


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    context = browser.new_context(viewport=LARGE, has_touch=True)
    context.set_default_timeout(LIMIT_S * 1000)
    yield context
    context.close()


@pytest.fixture
def page(context: BrowserContext) -> Iterator[Page]:
    """An empty page. An error in its scripts fails the test."""
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if "Content Security" in message.text else None)
    yield page
    assert not errors, errors


class PageFleet(RunningFleet):
    """A fleet for tests that drive a browser, whose driver has an event loop in this thread."""

    def ask(self, act: Callable[[Tutti], Coroutine[Any, Any, T]]) -> T:
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(super().ask, act).result()


@pytest.fixture(scope="session")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningFleet]:
    fleet = PageFleet(tmp_path_factory.mktemp("browser"), web=True)
    try:
        yield fleet.started()
    finally:
        fleet.close()


def find_address(fleet: RunningFleet) -> str:
    """The address of the page."""
    return fleet.output().partition("page on ")[2].split()[0].rstrip(";")


class MockedStream:
    """The page without a gateway: what the socket sends is written by the test.

    sent: what the page has sent. replies: what requests are answered, by their paths without query; a list is
    answered one after the other, its last element for ever. asked: the requests with these paths, and their bodies.
    beating: an empty patch is sent three times a second, as a gateway does whose state does not change; without it
    the page shows after 1 s that its state is old, and refuses what moves. policy: the content security policy of the
    page.
    """

    def __init__(self, page: Page, state: dict[str, Any], **hello: Any) -> None:
        self.page = page
        self.sent: list[dict[str, Any]] = []
        self.answers: dict[str, Any] = {}
        self.replies: dict[str, Any] = {}
        self.asked: list[tuple[str, Any]] = []
        self._state, self._hello = state, {**HELLO, "role": "operator", "may": MAY, **hello}
        self.beating = True
        self.policy = ""
        self._number = 0
        self._socket: WebSocketRoute | None = None
        page.route(f"{MOCKED}**", self._serve)
        page.route_web_socket("**/v1/stream*", self._accept)

    def open(self, view: str = "run") -> "MockedStream":
        self.page.goto(f"{MOCKED}#{view}")
        self.page.get_by_role("region", name="Stop bar").wait_for()
        return self

    def send(self, frame: dict[str, Any]) -> None:
        assert self._socket is not None
        self._socket.send(json.dumps(frame))

    def patch(self, patch: dict[str, Any]) -> None:
        self._number += 1
        self.send({"n": self._number, "patch": patch})

    def beat(self) -> None:
        if self.beating and self._socket is not None:
            self.patch({})

    def mute(self) -> None:
        """Answer no frame any more."""
        assert self._socket is not None
        self._socket.on_message(lambda message: self.sent.append(json.loads(message)))

    def close(self) -> None:
        """Close the socket. The page opens another."""
        assert self._socket is not None
        socket, self._socket = self._socket, None
        socket.close()

    def find(self, do: str) -> list[dict[str, Any]]:
        """The frames of the page with this verb."""
        return [each for each in self.sent if each["do"] == do]

    def _accept(self, socket: WebSocketRoute) -> None:
        self._socket = socket
        socket.on_message(self._take)
        self.send({"hello": self._hello})
        self.send({"n": 0, "state": self._state})

    def _take(self, message: str | bytes) -> None:
        frame = json.loads(message)
        self.sent.append(frame)
        if "id" in frame:
            answer = self.answers.get(frame["do"], {"ok": {}})
            if frame["do"] == "acquire":
                answer = {"ok": {"axes": frame["axes"]}}
            self.send({"answer": frame["id"], **answer})

    def _serve(self, route: Any) -> None:
        name = route.request.url.partition("#")[0].partition("?")[0].removeprefix(MOCKED)
        path = PAGE / (name or "index.html")
        reply = self.replies.get(name.removeprefix("v1/"))
        if reply is not None:
            if route.request.method == "POST":
                self.asked.append((name.removeprefix("v1/"), route.request.post_data_json))
            if isinstance(reply, list):
                reply = reply.pop(0) if len(reply) > 1 else reply[0]
            route.fulfill(json=reply)
        elif path.is_file():
            route.fulfill(path=path, headers={"Content-Security-Policy": self.policy} if self.policy else None)
        else:
            route.fulfill(status=503, json={"refused": {"code": "absent", "text": "no gateway", "remedy": ""}})


MAY = [
    *("acknowledge", "acquire-axes", "alarms", "approve", "cancel", "check-job", "dry-run", "estop", "hold", "jog"),
    *("list", "names", "pause", "positions", "release", "reorder", "reset", "resume", "retry", "shelve", "show"),
    *("start-queue", "statistics", "stop", "stop-queue", "submit", "work", "check-wiring", "save-position", "go"),
]


def make_axis(**fields: Any) -> dict[str, Any]:
    return {
        "position": 12.5,
        "commanded": 12.5,
        "velocity": 0.0,
        "unit": "mm",
        "moving": False,
        "homing": False,
        "enabled": True,
        "referenced": True,
        "limit": "none",
        "offset": "0",
        "min": -10.0,
        "max": 400.0,
        "max_velocity": 200.0,
        "manual_speed": 0.2,
        **fields,
    }


def make_controller(axes: dict[str, Any], **fields: Any) -> dict[str, Any]:
    return {
        "mode": "idle",
        "age_s": 0,
        "present": True,
        "make": "smc4000",
        "epoch": 1,
        "digest": "0",
        "faults": [],
        "inputs": {},
        "outputs": {},
        "axes": axes,
        **fields,
    }


def make_state(**fields: Any) -> dict[str, Any]:
    """The state of a fleet of one controller with two axes."""
    return {
        "fleet": "lab",
        "utc": "2026-01-01T00:00:00Z",
        "coordinator": {"present": True, "name": "c", "epoch": 1},
        "controllers": {"gantry": make_controller({"x": make_axis(), "y": make_axis(position=3.25)})},
        "leases": {},
        "permits": [],
        "queue": {"waiting": 0, "total": 0, "jobs": []},
        "jobs": {},
        "members": {},
        "alarms": {},
        "events": [],
        **fields,
    }


def make_entry(name: str, **fields: Any) -> dict[str, Any]:
    """A waiting job in the queue."""
    return {
        "id": f"id-{name}",
        "name": name,
        "actor": "anna@127.0.0.1",
        "state": "queued",
        "reason": "waits for gantry: job 'other' 1234 of anna",
        "submitted_utc": "2026-01-01T00:00:00.000000Z",
        "place": 1,
        "terms": {"priority": 0, "repeat": 1, "after": None, "at": None, "missed": "skip", "held": False},
        "held_by": "",
        "origin": None,
        "from_step": 0,
        "proposed": False,
        **fields,
    }


@pytest.fixture
def mock(page: Page) -> Callable[..., MockedStream]:
    streams: list[MockedStream] = []
    page.expose_function("beat", lambda: streams[-1].beat())
    page.add_init_script("setInterval(() => beat(), 333)")

    def open_mock(
        state: dict[str, Any] | None = None,
        view: str = "run",
        replies: dict[str, Any] | None = None,
        policy: str = "",
        **hello: Any,
    ) -> MockedStream:
        stream = MockedStream(page, make_state() if state is None else state, **hello)
        stream.replies |= replies or {}
        stream.policy = policy
        streams.append(stream)
        return stream.open(view)

    return open_mock
