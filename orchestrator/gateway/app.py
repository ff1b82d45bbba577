"""The gateway as an ASGI application: routes, and the rights that they need. It also runs in virtual time."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from orchestrator.bus.decoding import MAX_AT_ONCE
from orchestrator.bus.log import ProcessLog
from orchestrator.bus.service_verbs import CONTROLLER_VERBS, SERVICE_VERBS
from orchestrator.client import Tutti
from orchestrator.clock.base import Clock
from orchestrator.clock.executor import Executor, run_inline
from orchestrator.gateway.access.authentication import Authentication, NotSignedIn
from orchestrator.gateway.access.cookies import BrowserMarks, CookieNames, load_key
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.users import UserFile
from orchestrator.gateway.commands import FleetCommands
from orchestrator.gateway.fleet_files import compare_fleet
from orchestrator.gateway.guard import Guard
from orchestrator.gateway.job_files import JobFiles
from orchestrator.gateway.open_stops import OpenStops
from orchestrator.gateway.reads import FleetReads, Reader, ReadRequest
from orchestrator.gateway.replies import RefusedRequest, make_model_response, make_refusal_response
from orchestrator.gateway.service_requests import read_fields, require_body_budget
from orchestrator.gateway.sessions import SessionRequests, find_address
from orchestrator.gateway.stream.acts import FleetActs
from orchestrator.gateway.stream.fleet_parts import allows_open_stop, list_views
from orchestrator.gateway.stream.hub import StreamHub
from orchestrator.gateway.stream.need import read_query
from orchestrator.gateway.stream.socket import UserSocket
from orchestrator.model.errors import NoName, Refusal
from orchestrator.model.problems import describe_first_error

MAX_SOCKETS = 200
MAX_KEY = 200
PAGE = Path(__file__).parent / "static"
NO_PAGE = (
    "The operators' page is not part of this installation. In a source tree build it with `make page`; the HTTP "
    "interface is there: /v1/openapi.json\n"
)

Act = Callable[[Identity, Mapping[str, Any]], Awaitable[Any]]


@dataclass(frozen=True, slots=True)
class GatewayOptions:
    """port: under which it is addressed. secure: with TLS. users: their file. jobs: the folder of templates.
    recordings: their folder. page: the folder of the built page. new_secret: returns 32 random bytes as text.
    names: by which other computers reach it; with any, nothing is let in without users. decode: for large requests.
    check: for long job files and programs."""

    port: int
    users: Path
    new_secret: Callable[[], str]
    jobs: Path | None = None
    recordings: Path | None = None
    secure: bool = False
    page: Path = PAGE
    names: Sequence[str] = ()
    decode: Executor = run_inline
    check: Executor = run_inline


class Gateway:
    """One gateway. `start` it, serve `app`, then `close` it before the bus."""

    def __init__(self, tutti: Tutti, clock: Clock, log: ProcessLog, execute: Executor, options: GatewayOptions) -> None:
        """execute: for passwords, files and other work that takes long."""
        self.hub = StreamHub(tutti, clock)
        self._clock, self._log, self._execute, self._options = clock, log, execute, options
        self._authentication = Authentication(
            UserFile(options.users), clock, execute, options.new_secret, open_without_users=not options.names
        )
        cookies = CookieNames(tutti.keys.fleet, options.port, secure=options.secure)
        marks = BrowserMarks(load_key(options.users.parent))
        self._sessions = SessionRequests(self._authentication, cookies, marks, log, options.new_secret)
        self._commands = FleetCommands(tutti, clock, log, options.decode, self._note_stop)
        self._commands.known_controllers = lambda: self.hub.state.controllers
        self._files = JobFiles(options.jobs, execute, options.check)
        self._reads = FleetReads(self._commands, self.hub, self._files, options.recordings, execute)
        self._sockets: set[UserSocket] = set()
        self._acts: Mapping[str, Act] = {
            "stop": self._stop,
            "estop": self._estop,
            "reset": self._reset,
            "check-job": self._check_job,
            "check-fleet": self._check_fleet,
        }
        self._open_stops = OpenStops(clock, lambda: allows_open_stop(self.hub.state.fleet))
        app = Starlette(routes=self._make_routes())
        self.guard = Guard(
            app,
            options.port,
            self._sessions.is_signed_in,
            secure=options.secure,
            views=lambda: list_views(self.hub.state.fleet),
        )
        self.guard.admit(options.names)
        self.app: ASGIApp = self.guard

    async def start(self) -> None:
        """Follow the fleet."""
        await self.hub.start()

    async def close(self) -> None:
        """End the sockets, and what they have begun."""
        await asyncio.gather(*(socket.disconnect(1012, "the gateway ends") for socket in list(self._sockets)))
        await self.hub.close()

    @property
    def read_paths(self) -> list[str]:
        """The paths of GET, as routes have them."""
        return list(self._reads.readers)

    def _make_routes(self) -> list[BaseRoute]:
        routes: list[BaseRoute] = [
            Route("/v1/session", self._handle(self._sessions.show_session), methods=["GET"]),
            Route("/v1/login", self._handle(self._sign_in), methods=["POST"]),
            Route("/v1/logout", self._handle(self._sessions.sign_out), methods=["POST"]),
            WebSocketRoute("/v1/stream", self._serve_socket),
        ]
        for path, reader in self._reads.readers.items():
            routes.append(Route(path, self._handle(self._make_read(reader)), methods=["GET"]))
        routes.append(Route("/v1/sign-in", self._show_sign_in, methods=["GET"]))
        routes.append(Route("/v1/stop", self._handle(self._stop_openly), methods=["POST"]))
        for verb, act in self._acts.items():
            routes.append(Route(f"/v1/{verb}", self._handle(self._make_act(verb, act)), methods=["POST"]))
        for verb in SERVICE_VERBS.keys() - self._acts.keys():
            routes.append(Route(f"/v1/{verb}", self._handle(self._make_verb(verb)), methods=["POST"]))
        for verb in CONTROLLER_VERBS:
            path = f"/v1/controllers/{{controller}}/{verb}"
            routes.append(Route(path, self._handle(self._make_controller_verb(verb)), methods=["POST"]))
        routes.append(Route("/v1/{rest:path}", self._handle(_refuse_unknown), methods=["GET", "POST"]))
        return [*routes, *self._make_page_routes()]

    def _make_page_routes(self) -> list[BaseRoute]:
        if (self._options.page / "index.html").is_file():
            return [Mount("/", StaticFiles(directory=self._options.page, html=True))]

        async def explain(_: Request) -> Response:
            return Response(NO_PAGE, 404, media_type="text/plain")

        return [Route("/", explain)]

    # Requests

    def _handle(self, handler: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
        """The handler, with refusals as answers. An error that is none is a defect: it is logged."""

        async def handle(request: Request) -> Response:
            try:
                return await handler(request)
            except RefusedRequest as error:
                return make_refusal_response(error.refusal, error.status)
            except NotSignedIn as error:
                return make_refusal_response(error, 401)
            except ClientDisconnect:
                return Response(status_code=400)  # which nothing receives any more
            except Refusal as error:
                return make_refusal_response(error)
            except NoName as error:
                return make_refusal_response(Refusal("unknown-name", str(error), "see /v1/names"))
            except ValidationError as error:  # a value in the path or the query
                text = describe_first_error(error, "the request")
                return make_refusal_response(Refusal("bad-request", text, "see /v1/openapi.json"))
            except Exception as error:
                self._log.warning(f"defect in {request.url.path}: {error!r}", path=request.url.path)
                refusal = Refusal("defect", "the gateway has a defect here", "see its log, and report it")
                return make_refusal_response(refusal, 500)

        return handle

    def _admit(self, request: Request, verb: str) -> Identity:
        """The identity behind a POST that may use `verb`. Raises `Refusal`, `RefusedRequest`."""
        identity = self._sessions.identify(request)
        if identity.access == "cookie" and request.headers.get("x-tutti-csrf", "") != identity.csrf:
            text = "the header X-Tutti-CSRF is missing, or not that of the session"
            raise RefusedRequest(403, Refusal("bad-csrf", text, "send `csrf` of GET /v1/session in it"))
        identity.require_right(verb)
        return identity

    async def _authorise(self, request: Request, verb: str) -> tuple[Identity, dict[str, Any]]:
        """The identity behind a POST that may use `verb`, and its body. Raises `Refusal`, `RefusedRequest`."""
        return self._admit(request, verb), await self._read_body(request, verb)

    async def _read_body(self, request: Request, verb: str) -> dict[str, Any]:
        body = await _read_json(request, verb)
        return await self._execute(read_fields, body) if len(body) > MAX_AT_ONCE else read_fields(body)

    def _make_read(self, reader: Reader) -> Callable[[Request], Awaitable[Response]]:
        async def read(request: Request) -> Response:
            values = {**request.query_params, **request.path_params}
            return await reader(ReadRequest(self._sessions.identify(request), values))

        return read

    def _make_act(self, verb: str, act: Act) -> Callable[[Request], Awaitable[Response]]:
        async def carry_out(request: Request) -> Response:
            answer = await act(*await self._authorise(request, verb))
            return answer if isinstance(answer, Response) else JSONResponse(answer)

        return carry_out

    def _make_verb(self, verb: str) -> Callable[[Request], Awaitable[Response]]:
        async def pass_on(request: Request) -> Response:
            identity, body = self._admit(request, verb), await _read_json(request, verb)
            key = request.headers.get("idempotency-key", "")[:MAX_KEY]
            return make_model_response(await self._commands.request_body(identity, verb, body, key))

        return pass_on

    def _make_controller_verb(self, verb: str) -> Callable[[Request], Awaitable[Response]]:
        async def pass_on(request: Request) -> Response:
            identity, fields = await self._authorise(request, verb)
            controller = str(request.path_params["controller"])
            return make_model_response(await self._commands.request_controller(identity, verb, controller, fields))

        return pass_on

    async def _sign_in(self, request: Request) -> Response:
        return await self._sessions.sign_in(request, await self._read_body(request, "login"))

    async def _show_sign_in(self, _: Request) -> Response:
        """What a page may know before a user has signed in."""
        return JSONResponse({"stop": self._open_stops.is_allowed()})

    # Acts

    async def _stop_openly(self, request: Request) -> Response:
        """A stop of a user; where the fleet file allows it, also of a page that is not."""
        try:
            identity, _ = await self._authorise(request, "stop")
        except NotSignedIn:
            if not self._open_stops.is_allowed():
                raise
            identity = self._open_stops.admit_stop(find_address(request))
        return JSONResponse(await self._stop(identity, {}))

    async def _stop(self, identity: Identity, _: Mapping[str, Any]) -> Any:
        return await self._commands.stop("stop", self._commands.connect(identity), "")

    async def _estop(self, identity: Identity, body: Mapping[str, Any]) -> Any:
        return await self._commands.stop("estop", self._commands.connect(identity), str(body.get("reason", "")))

    async def _reset(self, identity: Identity, _: Mapping[str, Any]) -> Any:
        return await self._commands.reset(identity)

    async def _check_job(self, identity: Identity, body: Mapping[str, Any]) -> Any:
        return await self._files.check_job(self._commands.connect(identity), body)

    async def _check_fleet(self, identity: Identity, body: Mapping[str, Any]) -> Any:
        text = body.get("text")
        if not isinstance(text, str):
            raise Refusal("bad-request", "`text` must be the text of a fleet file", "")
        running_fleet = await self._commands.connect(identity).load_fleet()
        return await self._execute(compare_fleet, text, running_fleet)

    def _note_stop(self, what: str, actor: str, answers: dict[str, Any]) -> None:
        """Show a stop on every page."""
        stop = self.hub.state.take_stop(what, actor)
        self.hub.note_change()
        for socket in self._sockets:
            socket.send({"stopped": {**stop, "answers": answers}})

    # Sockets

    async def _serve_socket(self, socket: WebSocket) -> None:
        try:
            identity = self._sessions.identify(socket)
        except NotSignedIn as error:
            await socket.send_denial_response(make_refusal_response(error, 401))
            return
        try:
            query = socket.query_params
            need = read_query(query.getlist("need"), query.get("most", ""), len(self.hub.state.controllers))
        except Refusal as error:
            await socket.send_denial_response(make_refusal_response(error))
            return
        if len(self._sockets) >= MAX_SOCKETS:
            refusal = Refusal("too-many", f"{MAX_SOCKETS} sockets are open", "close pages that are not used")
            await socket.send_denial_response(make_refusal_response(refusal, 503))
            return
        await socket.accept()
        reader = self.hub.add_reader(need)
        user = UserSocket(socket, reader, identity, self._clock, lambda: self._authentication.is_valid(identity))
        user.send({"hello": self._sessions.describe_session(identity)})
        self._sockets.add(user)
        try:
            await user.run(FleetActs(user, self._commands.connect(identity), self._clock, self._commands.stop))
        finally:
            self._sockets.discard(user)


async def _read_json(request: Request, verb: str) -> bytes:
    """The body of a request, within the budget of its verb, as it came. Raises `Refusal`, `RefusedRequest`."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    body = await request.body()
    if body and kind != "application/json":
        text = f"the body is {kind[:60] or 'of no type'}"
        raise RefusedRequest(415, Refusal("bad-request", text, "send JSON, with Content-Type: application/json"))
    require_body_budget(verb, body)
    return body


async def _refuse_unknown(request: Request) -> Response:
    raise RefusedRequest(
        404, Refusal("no-path", f"there is no {request.method} {request.url.path[:100]}", "see /v1/openapi.json")
    )
