"""Opening of Zenoh sessions and routers, with explicit endpoints only.

Nothing is discovered by multicast or gossip: all connections are configured. By TLS both sides have certificates of the
fleet's authority.
"""

# Zenoh's type stubs omit many return types.
# pyright: reportUnknownMemberType=false

import json
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import TracebackType

import zenoh

from orchestrator.bus.endpoint import find_host, is_private, is_socket, socket_path, split_endpoints, uses_tls
from orchestrator.bus.hosts_live import find_living
from orchestrator.bus.identity import VARIABLE, BadIdentity, Identity, find_identity, read_identity
from orchestrator.bus.limits import MAX_MESSAGE_BYTES
from orchestrator.bus.tls_probe import probe_tls
from orchestrator.model.errors import TuttiError

CONNECT_TIMEOUT_S = 5.0
"""How long to wait for a router that is starting."""

_RETRY_CONFIG = {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5}
"""Zenoh's own retry periods grow to 4 s. A restarted router on the same host should be found sooner."""

_ATTEMPT_S = 1.0
_ATTEMPT_GROWTH = 1.5
"""Of several routers, how long one is waited for before the next one is tried: longer each time, for one that is
busy."""

_LIVING_S = 0.3
"""For those that take connections to do so; they are tried first."""

_OPEN_MS = 2000
"""The same when a session connects again: Zenoh's own 10 s are long for a host whose router is dead."""

_ROUTER_LIMITS = {
    "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    "transport/unicast/accept_timeout": 1000,  # ms; for a connection to become a session, else it is closed
    "transport/unicast/accept_pending": 2000,  # connections that are not sessions yet; Zenoh's own limit is 100
    "transport/unicast/max_sessions": 1000,
    "scouting/delay": 0,  # nothing is scouted; otherwise a router listens half a second later
}
"""Connections that say nothing must not keep others out: 500 of them, with Zenoh's own 10 s, refused all new sessions,
also that of an e-stop."""


class RouterUnreachable(TuttiError):
    """No router answered at the endpoint in time."""


class RouterRefused(TuttiError):
    """The router cannot listen at the endpoint."""


def _make_common_settings(mode: str) -> dict[str, object]:
    return {"mode": mode, "scouting/multicast/enabled": False, "scouting/gossip/enabled": False}


def _to_config(settings: Mapping[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def open_session(endpoint: str, timeout_s: float = CONNECT_TIMEOUT_S) -> zenoh.Session:
    """Open a client session through the router at `endpoint`, e.g. `tcp/127.0.0.1:7447`. Blocks until it is
    connected. Of several endpoints, separated by commas, the first one that answers is used, in their order; one whose
    computer is dead is not waited for.

    When the router goes away and comes back, or another one of the endpoints is there, Zenoh reconnects and declares
    everything again. Raises `RouterUnreachable` after `timeout_s`, `BadEndpoint`, and `BadIdentity`.
    """
    endpoints = split_endpoints(endpoint)
    identity = require_identity(endpoint) if any(map(uses_tls, endpoints)) else None
    until_s = time.monotonic() + timeout_s
    attempt_s = _ATTEMPT_S if len(endpoints) > 1 else timeout_s
    while True:
        # At the first connection Zenoh waits for the first endpoint alone.
        endpoints = _put_living_first(endpoints, min(_LIVING_S, timeout_s / 2))
        left_s = until_s - time.monotonic()
        try:
            return zenoh.open(_make_client_config(endpoints, identity, min(left_s, attempt_s)))
        except zenoh.ZError as error:
            if until_s - time.monotonic() > 0.05 and len(endpoints) > 1:
                endpoints, attempt_s = [*endpoints[1:], endpoints[0]], _ATTEMPT_GROWTH * attempt_s
                continue
            raise RouterUnreachable(_explain_absence(endpoint, timeout_s, identity)) from error


def require_identity(endpoint: str) -> Identity:
    """The identity that the environment names, for an endpoint with TLS. Raises `BadIdentity` if there is none, or it
    does not count now."""
    folder = find_identity()
    if folder is None:
        text = f"{endpoint} needs a certificate; give the folder that `tutti keys add-…` has made"
        raise BadIdentity(f"{text}: --identity, or {VARIABLE} in the environment")
    identity = read_identity(folder)
    identity.require_valid(datetime.now(UTC))
    return identity


def _put_living_first(endpoints: list[str], limit_s: float) -> list[str]:
    """Those first, in their order, that take connections, or cannot be asked."""
    if len(endpoints) < 2:
        return endpoints
    hosts = {endpoint: find_host(endpoint) for endpoint in endpoints}
    living_hosts = find_living([host for host in hosts.values() if host is not None], limit_s)
    return sorted(endpoints, key=lambda endpoint: hosts[endpoint] is not None and hosts[endpoint] not in living_hosts)


def _make_client_config(endpoints: list[str], identity: Identity | None, timeout_s: float) -> zenoh.Config:
    settings: dict[str, object] = {
        "connect/endpoints": endpoints,
        "connect/timeout_ms": max(1, round(timeout_s * 1000)),
        "connect/exit_on_failure": True,
        "connect/retry": _RETRY_CONFIG,
        "listen/endpoints": [],
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    }
    if len(endpoints) > 1:
        settings["transport/unicast/open_timeout"] = _OPEN_MS
    if identity is not None:
        settings["transport/link/tls"] = {
            "root_ca_certificate": str(identity.authority),
            "connect_certificate": str(identity.certificate),
            "connect_private_key": str(identity.key),
            "enable_mtls": True,
            "close_link_on_expiration": True,
        }
    return _to_config({**_make_common_settings("client"), **settings})


def _explain_absence(endpoint: str, timeout_s: float, identity: Identity | None) -> str:
    text = f"no router answered at {endpoint} within {timeout_s:g} s"
    if identity is None:
        return f"{text}; start one there (`tutti up FLEET`), or give the right endpoint with --connect"
    # A router that refuses a certificate closes without a word.
    reasons = "; ".join(
        reason for reason in map(partial(probe_tls, identity=identity), split_endpoints(endpoint)) if reason
    )
    remedy = "start one there (`tutti router`), or give the right endpoint with --connect"
    return f"{text}, as {identity.common_name}: {reasons or remedy}"


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


def make_router_settings(endpoint: str, security: Mapping[str, object], links: str = "") -> dict[str, object]:
    """All settings of a router in Zenoh's terms. security: those of TLS and of the access control. links: endpoints of
    other routers of the fleet, which are connected to whenever they are there."""
    other_endpoints = split_endpoints(links) if links else []
    ends = {
        "listen/endpoints": split_endpoints(endpoint),
        "connect/endpoints": other_endpoints,
        "connect/retry": _RETRY_CONFIG,
    }
    return {**_make_common_settings("router"), **ends, **_ROUTER_LIMITS, **security}


def open_router(
    endpoint: str, security: Mapping[str, object] | None = None, links: str = "", *, insecure: bool = False
) -> ZenohRouter:
    """Route for the fleet at `endpoint`; several are separated by commas.

    security: settings of TLS and of the access control. links: other routers of the fleet. insecure: it may listen to
    the network without. Raises `RouterRefused` for that without `insecure`, and if an endpoint is in use or malformed.
    """
    security = security or {}
    for part in split_endpoints(endpoint):
        if uses_tls(part) and not security:
            raise RouterRefused(f"{part} needs certificates; give the folder of keys: `tutti router --keys DIR`")
        if not (uses_tls(part) or is_private(part) or insecure):
            text = f"{part} would listen to the network without TLS"
            raise RouterRefused(f"{text}; use tcp/127.0.0.1:PORT, or tls/… with the fleet's keys (`tutti keys`)")
    try:
        session = zenoh.open(_to_config(make_router_settings(endpoint, security, links)))
        for part in filter(is_socket, split_endpoints(endpoint)):
            Path(socket_path(part)).chmod(0o600)
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
