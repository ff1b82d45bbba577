"""What happens to single messages on the in-memory bus: samples that are lost, repeated or late, and answers that are
lost. Zenoh keeps the order of one sender and repeats nothing; a reader that numbers its messages must bear both."""

from collections.abc import Callable, Sequence

from orchestrator.bus.base import BusSample

Deal = Callable[[BusSample], Sequence[int]]
"""Returns how much later than usual, ns, each copy of a sample arrives; none: it is lost."""

_AS_USUAL = (0,)


class Disturbances:
    """The disturbances of one net. unanswered: keys whose answers are lost."""

    def __init__(self) -> None:
        self._deals: dict[str, Deal] = {}
        self.unanswered: set[str] = set()

    def disturb_samples(self, key: str, deal: Deal) -> None:
        """Deal with the samples on a key otherwise from now on; in the place of an earlier disturbance of it."""
        self._deals[key] = deal

    def end(self, key: str) -> None:
        """Let samples and answers on a key pass again."""
        self._deals.pop(key, None)
        self.unanswered.discard(key)

    def deal(self, sample: BusSample) -> Sequence[int]:
        """How much later than usual each copy of a sample arrives, ns."""
        deal = self._deals.get(sample.key)
        return _AS_USUAL if deal is None else deal(sample)
