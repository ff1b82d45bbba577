"""A real browser with the page, headless, for measurements."""

import shutil
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

from playwright.async_api import Page, Request, ViewportSize, WebSocket, async_playwright

from orchestrator.bench.truth import NothingHappened

NAMES = ("chromium", "chromium-browser", "google-chrome")
SIZE: ViewportSize = {"width": 1280, "height": 800}
INSTALL = "install it: apt-get install chromium"


def find_browser() -> str:
    """The program of the browser. Raises `NothingHappened`."""
    for name in NAMES:
        path = shutil.which(name)
        if path is not None:
            return path
    raise NothingHappened(f"no browser is installed (tried {', '.join(NAMES)}); {INSTALL}")


class PageInBrowser:
    """The page, and the browser's own measurements of it."""

    def __init__(self, page: Page, session: Any, pid: int) -> None:
        self.page = page
        self.pid = pid
        self.sockets = 0
        self.first_requests: int | None = None
        """Requests that were made before the first frame arrived."""
        self._requests = 0
        self._session = session
        page.on("request", self._count_request)
        page.on("websocket", self._watch_socket)

    def _count_request(self, _: Request) -> None:
        self._requests += 1

    def _watch_socket(self, socket: WebSocket) -> None:
        self.sockets += 1
        socket.on("framereceived", self._note_frame)

    def _note_frame(self, _: bytes | str) -> None:
        if self.first_requests is None:
            self.first_requests = self._requests

    async def read_script_s(self) -> float:
        """The time that scripts have taken, s."""
        metrics = await self._session.send("Performance.getMetrics")
        return next(metric["value"] for metric in metrics["metrics"] if metric["name"] == "ScriptDuration")

    async def read_heap_bytes(self) -> float:
        """The heap in use after a forced collection."""
        for _ in range(2):
            await self._session.send("HeapProfiler.collectGarbage")
        return (await self._session.send("Runtime.getHeapUsage"))["usedSize"]


@asynccontextmanager
async def open_browser() -> AsyncGenerator[PageInBrowser]:
    """A browser with an empty page. Raises `NothingHappened` without a browser."""
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=find_browser(), args=["--no-sandbox"])
        try:
            page = await browser.new_page(viewport=SIZE)
            # Its answers are JSON, which the library does not type.
            session: Any = await page.context.new_cdp_session(page)
            await session.send("Performance.enable")
            await session.send("HeapProfiler.enable")
            browser_session: Any = await browser.new_browser_cdp_session()
            info = await browser_session.send("SystemInfo.getProcessInfo")
            pid = next(process["id"] for process in info["processInfo"] if process["type"] == "browser")
            yield PageInBrowser(page, session, pid)
        finally:
            await browser.close()
