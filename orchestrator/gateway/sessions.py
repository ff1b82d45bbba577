"""Requests about sessions: the present one, signing in and out, and the identity behind every other request."""

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, Response
from starlette.types import Scope

from orchestrator.bus.log import ProcessLog
from orchestrator.gateway.access.authentication import Authentication, NotSignedIn
from orchestrator.gateway.access.cookies import KNOWN_S, SESSION_S, BrowserMarks, CookieNames, find_cookie
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.sign_in_limits import SignInSource
from orchestrator.model.errors import Refusal


def find_address(connection: HTTPConnection) -> str:
    """The address of a client."""
    return connection.client.host if connection.client is not None else "local"


class SessionRequests:
    """The sessions of one gateway. new_id: returns random text."""

    def __init__(
        self,
        authentication: Authentication,
        cookies: CookieNames,
        marks: BrowserMarks,
        log: ProcessLog,
        new_id: Callable[[], str],
    ) -> None:
        self._authentication, self._cookies, self._marks = authentication, cookies, marks
        self._log, self._new_id = log, new_id

    def identify(self, connection: HTTPConnection) -> Identity:
        """The identity of a request. Raises `NotSignedIn`."""
        headers = connection.headers
        session = find_cookie(headers.get("cookie", ""), self._cookies.session)
        return self._authentication.identify(find_address(connection), session, headers.get("authorization", ""))

    def is_signed_in(self, scope: Scope) -> bool:
        """Whether a request comes with a right, before anything of its body is read."""
        try:
            self.identify(HTTPConnection(scope))
        except NotSignedIn:
            return False
        return True

    def describe_session(self, identity: Identity) -> dict[str, Any]:
        """What a page knows of its session."""
        return {
            "fleet": self._cookies.fleet,
            "version": version("tutti"),
            "user": identity.user or None,
            "role": identity.role,
            "users": identity.access != "open",
            "csrf": identity.csrf,
            "may": identity.list_rights(),
        }

    async def show_session(self, request: Request) -> Response:
        """Answer `GET /v1/session`."""
        return JSONResponse(self.describe_session(self.identify(request)))

    async def sign_in(self, request: Request, body: dict[str, Any]) -> Response:
        """Answer `POST /v1/login`."""
        user, password = body.get("user"), body.get("password")
        if not isinstance(user, str) or not isinstance(password, str):
            raise Refusal("bad-request", "`user` and `password` must be texts", "")
        address, name = find_address(request), self._cookies.name_browser(user)
        browser = self._marks.find_browser(user, find_cookie(request.headers.get("cookie", ""), name))
        try:
            secret, identity = await self._authentication.sign_in(user, password, SignInSource(address, browser))
        except Refusal as error:
            self._log.warning(f"sign-in of {user[:64]!r} from {address} refused: {error.code}")
            raise
        self._log.info(f"signed in: {identity.actor}", actor=identity.actor)
        response = JSONResponse(self.describe_session(identity))
        mark = self._marks.make_mark(user, browser or self._new_id()[:16])
        self._cookies.set_cookie(response, name, mark, KNOWN_S)
        self._cookies.set_cookie(response, self._cookies.session, secret, SESSION_S)
        return response

    async def sign_out(self, request: Request) -> Response:
        """Answer `POST /v1/logout`."""
        self._authentication.sign_out(find_cookie(request.headers.get("cookie", ""), self._cookies.session))
        response = JSONResponse({})
        self._cookies.set_cookie(response, self._cookies.session, "", 0)
        return response
