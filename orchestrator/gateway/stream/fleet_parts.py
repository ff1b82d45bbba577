"""Parts of the state that are made of the fleet file, or of the leader's heartbeat alone."""

from collections.abc import Sequence
from typing import Any

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.web_views import WebView

LEADER_NS = NS_PER_S  # ten heartbeats are missing


def list_views(fleet: Fleet | None) -> Sequence[WebView]:
    """The cameras of the machine; none while the fleet file is not known."""
    return () if fleet is None else fleet.web.views


def allows_open_stop(fleet: Fleet | None) -> bool:
    """Whether a stop needs no user; not while the fleet file is not known."""
    return fleet is not None and fleet.web.stop_without_signing_in


def show_views(fleet: Fleet | None) -> dict[str, Any]:
    """The cameras as a part of the state; without any no part."""
    views = [view.to_plain() for view in list_views(fleet)]
    return {"views": views} if views else {}


def show_leader(leader: tuple[int, LeaderHeartbeat] | None, now_ns: int) -> dict[str, Any]:
    """The coordinator that leads. leader: its last heartbeat, and when that was received."""
    if leader is None or now_ns - leader[0] > LEADER_NS:
        return {"present": False}
    heartbeat = leader[1]
    return {"present": True, "name": heartbeat.coordinator[:8], "epoch": heartbeat.epoch}
