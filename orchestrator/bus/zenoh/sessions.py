"""Opening of Zenoh sessions and routers, with explicit endpoints only.

Nothing is discovered by multicast or gossip: all connections are configured.
"""

# Zenoh's type stubs omit many return types.
# pyright: reportUnknownMemberType=false

import json
from types import TracebackType

import zenoh

from orchestrator.bus.endpoint import check_endpoint
from orchestrator.bus.limits import MAX_MESSAGE_BYTES
from orchestrator.model.errors import TuttiError

CONNECT_TIMEOUT_S = 5.0
"""How long to wait for a router that is starting."""

_RETRY_CONFIG = {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5}
"""Zenoh's own retry periods grow to 4 s. A restarted router on the same host should be found sooner."""

_LOOPBACK = ("tcp/127.", "tcp/localhost:", "tcp/[::1]:")


_ROUTER_LIMITS = {
    "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    "transport/unicast/accept_timeout": 1000,  # ms; for a connection to become a session, else it is closed
    "transport/unicast/accept_pending": 2000,  # connections that are not sessions yet; Zenoh's own limit is 100
    "transport/unicast/max_sessions": 1000,
}
"""Connections that say nothing must not keep others out: 500 of them, with Zenoh's own 10 s, refused all new sessions,
also that of an e-stop."""


class RouterUnreachable(TuttiError):
    """No router answered at the endpoint in time."""


class RouterRefused(TuttiError):
    """The router cannot listen at the endpoint."""


def _make_config(mode: str, **settings: object) -> zenoh.Config:
    config = zenoh.Config()
    wanted: dict[str, object] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        **settings,
    }
    for key, value in wanted.items():
        config.insert_json5(key, json.dumps(value))
    return config


def open_session(endpoint: str, timeout_s: float = CONNECT_TIMEOUT_S) -> zenoh.Session:
    """Open a client session through the router at `endpoint`, e.g. `tcp/127.0.0.1:7447`. Blocks until it is
    connected.

    When the router goes away and comes back, Zenoh reconnects and declares everything again. Raises
    `RouterUnreachable` after `timeout_s`, and `BadEndpoint`.
    """
    check_endpoint(endpoint)
    config = _make_config(
        "client",
        **{
            "connect/endpoints": [endpoint],
            "connect/timeout_ms": round(timeout_s * 1000),
            "connect/exit_on_failure": True,
            "connect/retry": _RETRY_CONFIG,
            "listen/endpoints": [],
            "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        },
    )
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise RouterUnreachable(
            f"no router answered at {endpoint} within {timeout_s:g} s; start one there (`tutti up FLEET`), or give the "
            "right endpoint with --connect"
        ) from error


class ZenohRouter:
    """The router that all processes of a fleet connect to. Runs in a process that does nothing else."""

    def __init__(self, endpoint: str, session: zenoh.Session) -> None:
        self.endpoint = endpoint
        self._session = session

    def __enter__(self) -> "ZenohRouter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop routing. Does nothing the second time."""
        if not self._session.is_closed():
            self._session.close()


def open_router(endpoint: str) -> ZenohRouter:
    """Route for the fleet at `endpoint`. Plain TCP is allowed on this host only: otherwise it raises
    `RouterRefused`.

    Raises `RouterRefused` also if the endpoint is in use or malformed.
    """
    if endpoint.startswith("tcp/") and not endpoint.startswith(_LOOPBACK):
        raise RouterRefused(f"{endpoint} would listen to the network without TLS; use tcp/127.0.0.1:PORT or tls/...")
    try:
        ends = {"listen/endpoints": [endpoint], "connect/endpoints": []}
        session = zenoh.open(_make_config("router", **ends, **_ROUTER_LIMITS))
    except zenoh.ZError as error:
        if "in use" in str(error):
            cause = (
                f"the router cannot listen at {endpoint}: it is in use by another process. Stop that one, "
                "or choose a free port"
            )
        else:
            cause = f"the router cannot listen at {endpoint}: {error}"
        raise RouterRefused(cause) from error
    return ZenohRouter(endpoint, session)
