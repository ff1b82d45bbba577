"""What a program that shows the whole fleet follows: samples in a queue, and how old the states are that hold still."""

import asyncio
from collections.abc import Callable, Mapping

from orchestrator.bus.base import BusSample
from orchestrator.bus.states.feed import Arrival
from orchestrator.bus.states.frame import Confirmation


class FollowedSamples:
    """A `FeedReceiver` with a queue. queue: the samples in their order, with the keys of their controllers.
    on_confirmed: called with what a host says of its controllers, when it says it."""

    def __init__(self, queue: asyncio.Queue[BusSample]) -> None:
        self.queue = queue
        self.on_confirmed: Callable[[Mapping[str, Confirmation]], None] = lambda _: None

    def take_arrival(self, arrival: Arrival) -> None:
        """Queue the samples of a message."""
        for sample in arrival.samples:
            self.queue.put_nowait(sample)
        if arrival.confirmations:
            self.on_confirmed(arrival.confirmations)

    def take_bad_frame(self, text: str) -> None:
        """Leave it out: the coordinator logs it."""
