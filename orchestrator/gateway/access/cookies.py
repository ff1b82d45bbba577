"""The cookies of the gateway: of a session, and of a browser that a user has signed in with before.

Browsers keep cookies by name and host, not by port: so fleet and port are in the names, and signing in at one gateway
of a computer ends no session at another one. With TLS they begin with `__Host-`, and no other host can set them
(RFC 6265bis, 4.1.3).
"""

import contextlib
import hmac
import os
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from starlette.responses import Response

from orchestrator.model.files.private_files import UnsafePath, read_private_file, replace_private_file

SESSION_S = 7 * 24 * 3600
KNOWN_S = 400 * 24 * 3600  # the longest that browsers keep one
KEY_FILE, KEY_BYTES = "browsers.key", 32


@dataclass(frozen=True, slots=True)
class CookieNames:
    """fleet, port: of the gateway. secure: it speaks TLS."""

    fleet: str
    port: int
    secure: bool = False

    @property
    def session(self) -> str:
        return f"{self._start}_session_{self.fleet}_{self.port}"

    def name_browser(self, user: str) -> str:
        """One for each user: a tablet has several."""
        return f"{self._start}_known_{self.fleet}_{self.port}_{user}"

    @property
    def _start(self) -> str:
        return "__Host-tutti" if self.secure else "tutti"

    def set_cookie(self, response: Response, name: str, value: str, age_s: int) -> None:
        """Set a cookie; with an empty value, delete it."""
        response.set_cookie(
            name,
            value,
            httponly=True,
            samesite="strict",
            secure=self.secure,
            path="/",
            max_age=age_s if value else 0,
        )


def find_cookie(header: str, name: str) -> str:
    """The value of a cookie in a header; empty if there is none. Other cookies of the host, whatever they are, do no
    harm."""
    for part in header.split(";"):
        cookie, _, value = part.strip().partition("=")
        if cookie == name:
            return value
    return ""


@dataclass(frozen=True, slots=True)
class BrowserMarks:
    """Marks of browsers that a user has signed in with: signed, and no right by themselves."""

    key: bytes

    def make_mark(self, user: str, browser: str) -> str:
        """browser: its id."""
        return f"{browser}.{self._sign(user, browser)}"

    def find_browser(self, user: str, mark: str) -> str:
        """The id of the browser of a mark; empty if it is none of this user."""
        browser, _, signature = mark.partition(".")
        is_own = hmac.compare_digest(signature.encode(), self._sign(user, browser).encode())
        return browser if browser and is_own else ""

    def _sign(self, user: str, browser: str) -> str:
        return hmac.new(self.key, f"{user} {browser}".encode(), sha256).hexdigest()


def load_key(folder: Path) -> bytes:
    """The key of the marks of browsers, made at the first time. Where it cannot be kept, it counts until the end of
    this process."""
    path = folder / KEY_FILE
    with contextlib.suppress(OSError, UnsafePath):
        stored_key = read_private_file(path)
        if len(stored_key) == KEY_BYTES:
            return stored_key
    new_key = os.urandom(KEY_BYTES)
    with contextlib.suppress(OSError, UnsafePath):
        replace_private_file(path, new_key)
    return new_key
