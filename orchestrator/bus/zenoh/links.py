"""The served keys of a router's sessions, which it declares anew to each router that it links with.

Zenoh (1.10.2, `unregister_queryable` in `net/routing/hat/router/queries.rs`) strikes a served key from those that a
router passes to new links when the last *other* router stops serving it, although a session of its own serves it still.
After the next loss of the link no request from the other side reaches that session, while samples pass.
"""

# Zenoh's type stubs omit many return types.
# pyright: reportUnknownMemberType=false, reportMissingModuleSource=false

import json
from collections.abc import Iterator

import zenoh
from zenoh.handlers import Callback

from orchestrator.bus.base import Priority
from orchestrator.bus.zenoh.threads import SenderThread

LIST_S = 5.0
"""For a router to list what its own sessions serve."""

STOP_S = 1.0
ADMIN_SETTINGS: dict[str, object] = {"adminspace/enabled": True}
"""The list is in the router's administration space. It can be read there, and nothing be written."""


class LinkRenewal:
    """Watches a router's links, and renews the served keys at each new one."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._thread = SenderThread("router-links", 1)
        # Held only so that it is not undeclared.
        self._events = session.info.declare_transport_events_listener(Callback(self._take_event, None, indirect=False))

    def close(self) -> None:
        """End a renewal that is in progress."""
        self._thread.stop(STOP_S)

    def _take_event(self, event: zenoh.TransportEvent) -> None:
        if event.kind == zenoh.SampleKind.PUT and event.transport.whatami == zenoh.WhatAmI.ROUTER:
            # Of several links at once one renewal is enough: whichever begins last lists all.
            self._thread.queue_call(Priority.STATE, self._renew)

    def _renew(self) -> None:
        """Change what is known of each served key for an instant: that alone makes Zenoh pass it on again."""
        for expression in list_served(self._session):
            pulse = self._session.declare_queryable(expression, Callback(_ignore, None, indirect=False), complete=True)
            pulse.undeclare()


def list_served(router: zenoh.Session) -> Iterator[str]:
    """The key expressions that sessions of this router serve. Blocks for up to `LIST_S`."""
    folder = f"@/{router.info.zid()}/router/queryable/"
    for reply in router.get(f"{folder}**", timeout=LIST_S):
        if reply.ok is not None and json.loads(reply.ok.payload.to_string())["clients"]:
            yield str(reply.ok.key_expr).removeprefix(folder)


def _ignore(query: zenoh.Query) -> None:
    """The session that serves the key is asked as well, and answers."""
    query.drop()
