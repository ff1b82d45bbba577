"""Authority in the fault campaign: epochs, and coordinators that were overtaken."""

from collections.abc import Callable, Sequence

from orchestrator.bus.base import BusSample
from orchestrator.bus.states.frame import decode_frame
from orchestrator.campaign.stages.hall import is_hall
from orchestrator.runtime.virtual.fleet import VirtualFleet


class AuthorityChecker:
    """Checks invariant 9 of one fleet. add_violation: called with the invariant and a text."""

    def __init__(self, fleet: VirtualFleet, add_violation: Callable[[str, str], None]) -> None:
        self._fleet = fleet
        self._add_violation = add_violation
        self._epochs: dict[str, int] = {}

    async def watch(self) -> None:
        """Follow what all adapters publish: on keys of their own, or in the frames of their hosts in a hall."""
        keys, bus = self._fleet.keys, self._fleet.make_client("watcher").bus
        if is_hall(self._fleet.fleet):
            await bus.subscribe(keys.host_states(), self._take_frame)
        else:
            await bus.subscribe(keys.state(), self.take_state)

    def _take_frame(self, sample: BusSample) -> None:
        for controller, leaf, payload in decode_frame(sample.payload).lines:
            if leaf == "state":
                self.take_state(BusSample(self._fleet.keys.state(controller), payload))

    def take_state(self, sample: BusSample) -> None:
        """An adapter publishes its state: it does not go back to an older epoch."""
        if not sample.payload.startswith(b'{"schema":"tutti.state/1"'):
            return  # garbage of an adversary
        _, _, remainder = sample.payload.partition(b'"epoch":')
        epoch = int(remainder[: remainder.index(b",")])
        if epoch < self._epochs.get(sample.key, 0):
            self._add_violation("9", f"{sample.key}: epoch {epoch} after {self._epochs[sample.key]}")
        self._epochs[sample.key] = epoch

    def check_leaders(self, former_leaders: Sequence[str]) -> None:
        """The leaders have different epochs, and an overtaken coordinator has detected its loss
        of leadership."""
        epochs = [
            coordinator.leadership.epoch
            for _, coordinator in self._fleet.coordinators.values()
            if coordinator.leadership.epoch
        ]
        if len(set(epochs)) != len(epochs):
            self._add_violation("9", f"two leaders with one epoch: {epochs}")
        for name in former_leaders:
            if not self._fleet.coordinators[name][1].leadership.over:
                self._add_violation("9", f"coordinator {name} was overtaken but still acts as leader")
