"""One request to an adapter host for several of its controllers."""

from collections.abc import Mapping

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.messages import BatchReply, BatchRequest

HOST_TIMEOUT_SHARE = 0.9
"""Share of the members' timeout after which an adapter host answers for those that have answered; the rest is for
its own answer."""


class HostBatches:
    """Sends requests to several controllers of one host."""

    def __init__(self, bus: Bus, keys: FleetKeys) -> None:
        self._bus = bus
        self._keys = keys

    def make_key(self, host: str, verb: str) -> str:
        """The key of a request for a verb."""
        return self._keys.batch_command(host, verb)

    async def ask(
        self, host: tuple[str, str | None], verb: str, texts: Mapping[str, str], timeout_s: float
    ) -> BatchReply:
        """Ask for all; return what has arrived in time. host: its name, and the process whose reply counts (None: of
        any). texts: by controller, its own request. Raises `BusError`, `ValidationError`."""
        name, server = host
        request = BatchRequest(requests=dict(texts), answer_within_ns=round(HOST_TIMEOUT_SHARE * timeout_s * NS_PER_S))
        key = self.make_key(name, verb)
        return BatchReply.read_message(await self._bus.request(key, request.to_json(), timeout_s, server))
