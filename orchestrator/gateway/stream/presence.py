"""Which controllers have an adapter on the bus: those of a host that is there, and those that announce themselves, as
hosts of protocol 1.5 let them."""

from collections import Counter
from collections.abc import Iterable

from orchestrator.bus.keys import SLOW_START


class AdapterPresence:
    """Pass each token of presence to `take_token`."""

    def __init__(self) -> None:
        self._tokens: Counter[tuple[str, str]] = Counter()
        self._hosts: dict[str, str] = {}
        """By controller: the host that carries it."""

    def take_token(self, key: str, *, present: bool) -> None:
        """A token has come, or gone. key: `…/live/{role}/{id}/{instance}`."""
        role, name, instance = key.split("/")[-3:]
        if instance != SLOW_START:
            count = self._tokens[role, name] + (1 if present else -1)
            self._tokens[role, name] = max(0, count)

    def take_carried(self, host: str, controllers: Iterable[str]) -> None:
        """A host has said which controllers it carries."""
        for controller in controllers:
            self._hosts[controller] = host

    def is_present(self, controller: str) -> bool:
        """Whether the adapter of a controller is there."""
        host = self._hosts.get(controller)
        return self._tokens["controller", controller] > 0 or (host is not None and self._tokens["host", host] > 0)
