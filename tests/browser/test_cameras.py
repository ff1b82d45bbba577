"""Cameras of the machine beside the axes: those of the fleet file, by the policy that the gateway sends."""

import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from browser.conftest import SMALL, MockedStream, make_state
from browser.test_rules import wait_for
from children import LIMIT_S
from playwright.sync_api import BrowserContext, Page, Route, expect

from orchestrator.gateway.guard import make_content_policy
from orchestrator.model.web_views import WebView

Mock = Callable[..., MockedStream]

IMAGE = {"title": "From above", "url": "http://cam.test/a.svg", "kind": "image"}
SIDE = {"title": "Side", "url": "http://media.test:8889/side", "kind": "page"}
PICTURE = '<svg xmlns="http://www.w3.org/2000/svg" width="64" height="36"><rect width="64" height="36"/></svg>'


def make_policy(*views: dict[str, Any]) -> str:
    return make_content_policy([WebView(**view) for view in views])


def answer(page: Page, body: str = "<p>video</p>") -> list[str]:
    """Let both cameras answer; the addresses that were asked for."""
    asked: list[str] = []

    def serve_picture(route: Route) -> None:
        asked.append(route.request.url)
        route.fulfill(body=PICTURE, content_type="image/svg+xml")

    def serve_page(route: Route) -> None:
        asked.append(route.request.url)
        route.fulfill(body=body, content_type="text/html")

    page.route("http://cam.test/**", serve_picture)
    page.route("http://media.test:8889/**", serve_page)
    return asked


@pytest.mark.parametrize("view", ["run", "setup"])
def test_a_picture_is_beside_the_axes(mock: Mock, page: Page, view: str) -> None:
    answer(page)
    mock(make_state(views=[IMAGE]), view=view, policy=make_policy(IMAGE))
    panel = page.get_by_role("region", name="Cameras")
    expect(panel.get_by_role("img", name="From above")).to_be_visible()
    expect(panel.get_by_text("waiting for the picture")).to_have_count(0)
    expect(panel.get_by_text("it is no sign that nothing moves")).to_be_visible()
    assert page.evaluate("document.querySelector('.camera img').naturalWidth") == 64


def test_without_cameras_there_is_no_panel(mock: Mock, page: Page) -> None:
    mock(policy=make_policy())
    expect(page.get_by_role("region", name="Axes")).to_be_visible()
    expect(page.get_by_role("region", name="Cameras")).to_have_count(0)


def test_one_is_loaded_at_a_time_and_none_while_they_are_hidden(mock: Mock, page: Page) -> None:
    asked = answer(page)
    mock(make_state(views=[IMAGE, SIDE]), policy=make_policy(IMAGE, SIDE))
    panel = page.get_by_role("region", name="Cameras")
    expect(panel.get_by_role("img", name="From above")).to_be_visible()
    assert asked == [IMAGE["url"]]
    panel.get_by_role("button", name="Side").click()
    expect(panel.frame_locator("iframe").get_by_text("video")).to_be_visible()
    assert page.locator(".camera img").count() == 0
    panel.get_by_role("button", name="Hide").click()
    expect(panel.locator("iframe")).to_have_count(0)
    page.reload()
    panel.get_by_role("button", name="Show").click()
    expect(panel.frame_locator("iframe").get_by_text("video")).to_be_visible()  # the choice is kept
    assert asked == [IMAGE["url"], SIDE["url"], SIDE["url"]]


def test_a_page_of_a_camera_cannot_leave_its_frame_or_take_the_keys(mock: Mock, page: Page) -> None:
    script = "<p>video</p><input autofocus><script>window.focus(); try { top.location = 'http://media.test:8889/x'; } catch {}</script>"
    answer(page, script)
    stream = mock(make_state(views=[SIDE]), policy=make_policy(SIDE))
    frame = page.locator(".camera iframe")
    expect(page.frame_locator(".camera iframe").get_by_text("video")).to_be_visible()
    assert frame.get_attribute("sandbox") == "allow-scripts allow-same-origin"
    box = frame.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert page.url.startswith("http://page.test/")
    page.keyboard.press("Pause")
    wait_for(page, lambda: stream.find("stop"))


def test_what_the_policy_does_not_name_is_not_loaded_and_the_page_says_so(context: BrowserContext) -> None:
    """As after a reload of the fleet file: the policy is as old as the page."""
    page = context.new_page()  # one whose policy may be violated
    asked = answer(page)
    stream = MockedStream(page, make_state())
    stream.policy = make_policy()
    stream.open()
    for view in (IMAGE, SIDE):
        stream.patch({"views": [view]})
        expect(page.get_by_text(f"{view['title']} was not known when this page was loaded")).to_be_visible()
    assert not asked


def test_a_camera_that_does_not_answer_says_so_and_is_tried_again(mock: Mock, page: Page) -> None:
    page.route("http://cam.test/**", lambda route: route.abort("connectionrefused"))
    mock(make_state(views=[IMAGE]), policy=make_policy(IMAGE))
    expect(page.get_by_text("From above does not answer")).to_be_visible()
    expect(page.get_by_text("Look whether cam.test is on")).to_be_visible()
    page.unroute("http://cam.test/**")
    answer(page)
    page.get_by_role("button", name="Try again").click()
    expect(page.get_by_text("does not answer")).to_have_count(0)
    expect(page.get_by_role("img", name="From above")).to_be_visible()


def test_a_stream_of_pictures_that_does_not_end_is_shown(mock: Mock, page: Page, context: BrowserContext) -> None:
    """A real one (MJPEG): a browser says of it that it is loaded at its end, and that does not come."""
    blank = context.new_page()
    picture = blank.screenshot(type="jpeg", clip={"x": 0, "y": 0, "width": 48, "height": 32})
    end = threading.Event()

    class Camera(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=part")
            self.end_headers()
            for _ in range(2):
                self.wfile.write(b"--part\r\nContent-Type: image/jpeg\r\n\r\n" + picture + b"\r\n")
            self.wfile.write(b"--part\r\n")
            end.wait(LIMIT_S)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        view = {**IMAGE, "url": f"http://127.0.0.1:{server.server_port}/stream.mjpg"}
        mock(make_state(views=[view]), policy=make_policy(view))
        wait_for(page, lambda: page.evaluate("document.querySelector('.camera img')?.naturalWidth") == 48)
        expect(page.get_by_text("waiting for the picture")).to_have_count(0)
    finally:
        end.set()
        server.shutdown()
        server.server_close()


@pytest.mark.parametrize("view", [IMAGE, SIDE])
def test_a_camera_that_is_silent_says_so_after_10_s(mock: Mock, page: Page, view: dict[str, Any]) -> None:
    page.clock.install()
    page.route("http://cam.test/**", lambda route: None)
    page.route("http://media.test:8889/**", lambda route: None)
    stream = mock(make_state(views=[view]), policy=make_policy(view))
    stream.beating = False
    expect(page.get_by_text("waiting for the picture")).to_be_visible()
    page.clock.fast_forward(11_000)
    expect(page.get_by_text(f"{view['title']} does not answer")).to_be_visible()
    expect(page.get_by_text("Nothing has come for 10 s.")).to_be_visible()


def test_titles_with_markup_are_texts(mock: Mock, page: Page) -> None:
    evil = "<img src=x onerror=alert(1)>"
    answer(page)
    mock(make_state(views=[{**IMAGE, "title": evil}]), policy=make_policy(IMAGE))
    expect(page.get_by_role("img", name=evil)).to_be_visible()
    assert page.locator("img").count() == 1


@pytest.mark.parametrize("size", [SMALL, {"width": 1280, "height": 800}])
def test_a_camera_fits_the_screen(mock: Mock, page: Page, size: Any) -> None:
    answer(page)
    page.set_viewport_size(size)
    mock(make_state(views=[IMAGE, SIDE]), policy=make_policy(IMAGE, SIDE))
    expect(page.get_by_role("img", name="From above")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    if size != SMALL:
        assert page.evaluate("document.documentElement.scrollHeight <= innerHeight")
