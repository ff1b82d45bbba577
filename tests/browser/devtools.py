"""A browser of its own, driven by its DevTools protocol alone: other drivers treat every tab as visible."""

import itertools
import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from children import LIMIT_S, wait_until
from websockets.sync.client import ClientConnection, connect


class Tab:
    """A tab: `evaluate` runs a script in it."""

    def __init__(self, tools: "DevTools", target: str) -> None:
        self._tools, self.target = tools, target
        self._session = tools.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def evaluate(self, script: str) -> Any:
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def open(self, url: str) -> None:
        """Load a page and wait until it is loaded: until then the tab has at times no context that runs a script."""
        self.call("Page.enable")
        self.call("Page.navigate", url=url)
        self._tools.wait_for_event("Page.loadEventFired", self._session)

    def call(self, method: str, **fields: Any) -> Any:
        return self._tools.call(method, self._session, **fields)

    def press_mouse(self, x: float, y: float) -> None:
        for kind in ("mouseMoved", "mousePressed"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def show(self) -> None:
        """Bring it to the front; the other tabs are hidden then."""
        self._tools.call("Target.activateTarget", targetId=self.target)


class DevTools:
    """The connection to a browser."""

    def __init__(self, link: ClientConnection) -> None:
        self._link = link
        self._numbers = itertools.count(1)
        self._events: list[dict[str, Any]] = []

    def call(self, method: str, session: str | None = None, **fields: Any) -> Any:
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": fields} | ({"sessionId": session} if session else {})
        self._link.send(json.dumps(message))
        while (answer := json.loads(self._link.recv(timeout=LIMIT_S))).get("id") != number:
            self._events.append(answer)
        assert "error" not in answer, answer
        return answer["result"]

    def wait_for_event(self, method: str, session: str) -> None:
        while not any(each.get("method") == method and each.get("sessionId") == session for each in self._events):
            self._events.append(json.loads(self._link.recv(timeout=LIMIT_S)))

    def open_tab(self, url: str) -> Tab:
        tab = Tab(self, self.call("Target.createTarget", url="about:blank")["targetId"])
        tab.open(url)
        return tab


@contextmanager
def open_tools(program: str, folder: Path) -> Iterator[DevTools]:
    """Start the browser, with its files in `folder`; it ends with the context."""
    command = [program, "--headless=new", "--no-sandbox", "--remote-debugging-port=0", f"--user-data-dir={folder}"]
    with subprocess.Popen([*command, "about:blank"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as process:
        try:
            place = folder / "DevToolsActivePort"
            wait_until(lambda: place.is_file() and len(place.read_text().splitlines()) == 2, "the browser is ready")
            port, path = place.read_text().splitlines()
            with connect(f"ws://127.0.0.1:{port}{path}", max_size=None) as link:
                yield DevTools(link)
        finally:
            process.terminate()
            process.wait(LIMIT_S)
