"""The leases of the fleet for the stream, by controller: a reader of few controllers costs no look at all of them."""

from collections.abc import Iterable
from typing import Any

from orchestrator.gateway.stream.merge_patch import drop_nulls
from orchestrator.model.report import LeaseState


class LeaseTable:
    """At most `most` leases."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._number = 0
        self._by_controller: dict[str, dict[str, dict[str, Any]]] = {}

    def take_lease(self, lease: LeaseState) -> None:
        """Store a lease, or forget one that has ended."""
        name = lease.controller if lease.axis is None else f"{lease.controller}.{lease.axis}"
        entries = self._by_controller.get(lease.controller, {})
        if lease.holder is None:
            self._number -= entries.pop(name, None) is not None
        elif self._number < self._most or name in entries:
            self._number += name not in entries
            entry = {"holder": lease.holder, "actor": lease.actor, "what": lease.what, "until_utc": lease.until_utc}
            self._by_controller.setdefault(lease.controller, {})[name] = drop_nulls(entry)

    def show(self, controllers: Iterable[str] | None) -> dict[str, Any]:
        """The leases by axis or controller, of these controllers; None: all."""
        names = self._by_controller if controllers is None else controllers
        return {name: entry for controller in names for name, entry in self._by_controller.get(controller, {}).items()}
