"""When the certificates of a fleet end: what would outlive one of them is refused before it begins.

The router closes a session at the end of its certificate, and what the adapter host moves is stopped then.
"""

from collections.abc import Iterable

from orchestrator.clock.base import Clock
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.errors import Refusal
from orchestrator.model.queue import parse_utc, shift_utc
from orchestrator.model.state import CertificateEnd

ENDS_BEFORE = "certificate-ends"
"""Code of the refusal."""


class CertificateEnds:
    """The ends of the certificates of adapter hosts, as they have stated them, and of the coordinator's own. None: a
    session without a certificate."""

    def __init__(self, view: FleetView, clock: Clock, own: CertificateEnd | None) -> None:
        self._view = view
        self._clock = clock
        self._own = own
        self._stated: dict[str, CertificateEnd | None] = {}

    def note_stated(self, controller: str, certificate: CertificateEnd | None) -> None:
        """Record what the adapter of a controller has stated when it was adopted."""
        self._stated[controller] = certificate

    def require_until(self, controllers: Iterable[str], within_s: float, not_before: str | None = None) -> None:
        """Raises `Refusal`, code `certificate-ends`, if something that takes `within_s` from now on would end after a
        certificate of these controllers' hosts, or of the coordinator. not_before: RFC 3339, where it begins later.
        """
        own = [(self._own.ends_utc, "", self._own)] if self._own is not None else []
        stated_ends = ((controller, self._stated.get(controller)) for controller in controllers)
        all_ends = own + [(end.ends_utc, controller, end) for controller, end in stated_ends if end is not None]
        if not all_ends:
            return
        ends_utc, controller, certificate = min(all_ends, key=lambda entry: entry[:2])
        end_utc = shift_utc(max(self._clock.utc(), not_before or ""), within_s)
        if end_utc < ends_utc:
            return
        holder, part = "the coordinator", "the coordinator"
        if controller:
            host = self._view.fleet.controllers[controller].host
            holder, part = f"{controller} (adapter host {host})", f"adapter host {host}"
        raise Refusal(
            ENDS_BEFORE,
            f"{holder}: its certificate {certificate.name} ends at {_show(ends_utc)}, and this would end at "
            f"{_show(end_utc)}",
            f"`tutti keys renew {certificate.name.rpartition('.')[0]}`, copy its folder, and restart {part}",
            controller or None,
        )


def _show(utc: str) -> str:
    return f"{parse_utc(utc):%Y-%m-%d %H:%M:%S} UTC"
