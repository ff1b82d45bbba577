"""What the operators' page shows besides the fleet: pictures and pages of cameras of the site."""

import re
from collections.abc import Iterable
from typing import Annotated, Literal
from urllib.parse import SplitResult, urlsplit

from pydantic import AfterValidator, Field, field_validator

from orchestrator.model.base import Model
from orchestrator.model.explain import show_value

MAX_VIEWS, MAX_TITLE, MAX_URL = 8, 60, 500  # views, characters
EXAMPLE = "http://camera-1.lab:8080/stream.mjpg"

# As a policy of the browser names it: no wildcard, no separator, no IPv6 address, which policies cannot name.
_HOST = re.compile(r"[a-z0-9](?:[a-z0-9.-]{0,251}[a-z0-9])?")


def _check_title(title: str) -> str:
    """A text that is seen as it is written. Raises `ValueError`."""
    if not title.strip() or not title.isprintable():
        raise ValueError("must be a text that is seen, without control characters, for example `From above`")
    return title.strip()


def _check_url(url: str) -> str:
    """An address that the page may show. Raises `ValueError`."""
    if not all("!" <= character <= "~" for character in url) or set(url) & set("\"'<>\\^`{|}"):
        raise ValueError("has a character that an address does not have; write it as %XX, for example %20 for a space")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise ValueError(f"is no address ({error}); write e.g. {EXAMPLE}") from None
    # Before what shows the address.
    if "@" in parts.netloc:
        raise ValueError(
            "has a user or a password, which every page would show; give the camera a user without a password for "
            "looking, or put a proxy before it"
        )
    if parts.scheme not in ("http", "https"):
        raise ValueError(f"found {show_value(url)}; it must begin with http:// or https://, e.g. {EXAMPLE}")
    if not parts.hostname:
        raise ValueError(f"found {show_value(url)}; it has no host, write e.g. {EXAMPLE}")
    if _HOST.fullmatch(parts.hostname) is None:
        raise ValueError(
            f"the host {show_value(parts.hostname)} is no name and no IPv4 address; a browser's policy can name only "
            "these (names with other letters in their xn-- form)"
        )
    if port == 0 or parts.netloc.endswith(":"):
        raise ValueError("has a colon and no port after its host; write a port from 1 to 65535, or neither")
    return url


class WebView(Model):
    """A camera of the machine, beside the axes. Every user of the page sees its address."""

    title: Annotated[str, AfterValidator(_check_title)] = Field(max_length=MAX_TITLE)
    url: Annotated[str, AfterValidator(_check_url)] = Field(
        max_length=MAX_URL, description=f"http:// or https://, as browsers reach it, e.g. {EXAMPLE}."
    )
    kind: Literal["image", "page"] = Field(
        default="image",
        description="image: a picture or a stream of pictures (MJPEG); page: a page of the camera or of a media server "
        "(WebRTC), in a frame that cannot leave its place.",
    )

    @property
    def origin(self) -> str:
        """Scheme, host and port: what a content security policy names."""
        parts: SplitResult = urlsplit(self.url)
        return f"{parts.scheme}://{parts.hostname}" + (f":{parts.port}" if parts.port is not None else "")


class WebSettings(Model):
    """What the operators' page shows besides the fleet, and whether its stop needs a user."""

    views: list[WebView] = Field(default=[], max_length=MAX_VIEWS, description="Cameras of the machine, at most 8.")
    stop_without_signing_in: bool = Field(
        default=False,
        description="The page that asks to sign in has *Stop*, and `POST /v1/stop` needs no user. An e-stop needs one.",
    )

    @field_validator("views")
    @classmethod
    def _check_titles(cls, views: list[WebView]) -> list[WebView]:
        titles = [view.title for view in views]
        double_title = next((title for title in titles if titles.count(title) > 1), None)
        if double_title is not None:
            raise ValueError(f"two views have the title {double_title!r}; give each its own")
        return views


def list_origins(views: Iterable[WebView], kind: Literal["image", "page"]) -> list[str]:
    """The origins of the views of a kind, each once, in order."""
    return list(dict.fromkeys(view.origin for view in views if view.kind == kind))
