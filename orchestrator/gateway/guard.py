"""Checks before any handler: the names under which the gateway is addressed, the origin of pages, and sizes.

A page of another site that a browser on this machine shows can send requests to 127.0.0.1, also under a name that its
owner's name server resolves to that address (DNS rebinding). So `Host` must be one of the gateway's own names and
`Origin`, which browsers always send with sockets and with requests that change something, one of its own origins; for
stops as well. Its own names are those of its computer's loopback; where other computers reach it, also those in its
certificate.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from orchestrator.gateway.bodies import MAX_BODY_BYTES, BodyReader, explain_size
from orchestrator.gateway.connections import MAX_CONNECTIONS, STOP_RESERVE, Connection
from orchestrator.gateway.reach import OWN_NAMES
from orchestrator.gateway.replies import make_refusal_response
from orchestrator.model.errors import Refusal
from orchestrator.model.web_views import WebView, list_origins

MAX_HEADER_BYTES = 32_000
CONNECTION = "connection"  # in the state of a scope: the `Connection` that it came by
STOP_PATHS = ("/v1/stop", "/v1/estop")
STRICT_TRANSPORT = "max-age=2592000"  # 30 days (RFC 6797)

SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def make_content_policy(views: Sequence[WebView]) -> str:
    """What a browser may load for the page: its own files, and of other origins the cameras of the fleet file alone,
    each by its kind."""
    images, pages = list_origins(views, "image"), list_origins(views, "page")
    return "; ".join(
        (
            "default-src 'self'",
            " ".join(("img-src 'self' data: blob:", *images)),
            *((" ".join(("frame-src", *pages)),) if pages else ()),
            "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
        )
    )


def find_headers(scope: Scope) -> dict[str, str]:
    """The headers of a request, by lower-case names; of a repeated one, the last."""
    return {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}


def measure_head(scope: Scope) -> int:
    """The bytes of the first line and the headers of a request: of those in one piece the server takes any number."""
    sizes = (len(name) + len(value) + 4 for name, value in scope["headers"])
    return len(scope.get("raw_path") or b"") + len(scope["query_string"]) + sum(sizes)


def find_connection(scope: Scope) -> Connection:
    """The connection of a request; one of its own where the server keeps none."""
    state: dict[str, Any] = scope.setdefault("state", {})
    return state.setdefault(CONNECTION, Connection("local", 0.0, lambda: None))


class Guard:
    """Refuses requests and sockets from elsewhere and bodies that are too large, and adds security headers."""

    def __init__(
        self,
        app: ASGIApp,
        port: int,
        is_signed_in: Callable[[Scope], bool],
        *,
        secure: bool = False,
        views: Callable[[], Sequence[WebView]] = tuple,
    ) -> None:
        """port: of the gateway. is_signed_in: whether a request has the right to be here, by its head. secure: it
        speaks TLS. views: called for the cameras that the page may show now."""
        self._app, self._views, self._is_signed_in = app, views, is_signed_in
        self._bodies = BodyReader()
        self._scheme, self._port = ("https" if secure else "http"), port
        self._own_hosts = set(self._list_hosts(OWN_NAMES))
        self.admit(())

    def admit(self, names: Iterable[str], why: str = "") -> None:
        """Answer to these names from now on, besides loopback's. why: there are none, in words for a refusal."""
        self._hosts = {*self._list_hosts(names), *self._own_hosts}
        self._origins = {f"{self._scheme}://{host}" for host in self._hosts}
        self._why = why

    def _list_hosts(self, names: Iterable[str]) -> Iterable[str]:
        for name in names:
            yield f"{name}:{self._port}"
            if self._port == (443 if self._scheme == "https" else 80):
                yield name

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = find_headers(scope)
        refusal = self._find_refusal(headers)
        if refusal is not None:
            await make_refusal_response(refusal, 403)(scope, receive, send)
            return
        if measure_head(scope) > MAX_HEADER_BYTES:
            text = f"the headers have more than {MAX_HEADER_BYTES:,} bytes"
            await make_refusal_response(Refusal("bad-request", text, "send fewer cookies"))(scope, receive, send)
            return
        find_connection(scope).signed_in = self._is_signed_in(scope)
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
            return
        await self._guard_request(scope, receive, send)

    def _find_refusal(self, headers: Mapping[str, str]) -> Refusal | None:
        host, origin = headers.get("host", "").lower(), headers.get("origin", "").lower()
        if host not in self._hosts:
            text = f"the gateway is not {host[:100] or '(no host)'}{f': {self._why}' if self._why else ''}"
            return Refusal("bad-host", text, f"open it as one of: {', '.join(sorted(self._hosts))}")
        if origin and origin not in self._origins:
            text = f"a page of {origin[:100]} must not use this gateway"
            return Refusal("bad-origin", text, f"open its own page: {min(self._origins)}")
        return None

    async def _guard_request(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = find_headers(scope)
        added_headers = {"Content-Security-Policy": make_content_policy(self._views()), **SECURITY_HEADERS}
        if self._scheme == "https" and headers["host"].lower() not in self._own_hosts:
            # Not for `localhost`: a browser would then refuse every other plain page there.
            added_headers["Strict-Transport-Security"] = STRICT_TRANSPORT

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                present = {name.lower() for name, _ in message["headers"]}
                message = {
                    **message,
                    "headers": [
                        *message["headers"],
                        *(
                            (name.encode(), value.encode())
                            for name, value in added_headers.items()
                            if name.lower().encode() not in present
                        ),
                    ],
                }
            await send(message)

        connection = find_connection(scope)
        refusal = self._find_busy(scope, connection)
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > MAX_BODY_BYTES:
            await make_refusal_response(explain_size(), 413)(scope, receive, send_guarded)
        elif refusal is not None:
            await make_refusal_response(refusal, 503)(scope, receive, send_guarded)
        else:
            async with self._bodies.read_body(receive, signed_in=connection.signed_in) as receive_limited:
                await self._app(scope, receive_limited, send_guarded)

    def _find_busy(self, scope: Scope, connection: Connection) -> Refusal | None:
        """The refusal of a request in the places that are kept for stops."""
        if not connection.beyond or scope["path"] in STOP_PATHS:
            return None
        text = f"{MAX_CONNECTIONS} connections are open, and the last {STOP_RESERVE} are for stops"
        return Refusal("too-many", text, "close pages and programs that are not used, or try again in a second")
