"""Starts by a trigger line: an output of one controller that is wired to inputs of members."""

from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_US
from orchestrator.model.fleet import TriggerWire
from orchestrator.model.messages import StartOptions, TriggerDrive, TriggerWait
from orchestrator.model.names import split_name


@dataclass(frozen=True, slots=True)
class TriggerStart:
    """A trigger line that starts members of a step.

    wire: from the output of `driver`, made active at T0. waiters: by member, the input that it waits for. edge: window
    of the output's edge relative to T0, ns, as the driver proposes it. shift_ns: how much later than T0 the other
    members start, to coincide with the waiters, whose wires, inputs and firmware add delays.
    """

    wire: TriggerWire
    waiters: dict[str, str]
    edge: tuple[int, int] = (0, 0)
    shift_ns: int = 0

    @property
    def driver(self) -> str:
        """The controller that drives the line."""
        return split_name(self.wire.from_)[0]

    def covers(self, member: str) -> bool:
        """Whether the member drives the line or waits for it."""
        return member == self.driver or member in self.waiters

    def start_options(self, member: str, lead_ns: int) -> StartOptions:
        """The start options of the driver or of a waiter."""
        if member == self.driver:
            return StartOptions(lead_ns=lead_ns, drive=TriggerDrive(output=split_name(self.wire.from_)[1]))
        least_ns, most_ns = (delay_us * NS_PER_US for delay_us in self.wire.delay_us)
        wait = TriggerWait(
            input=self.waiters[member], earliest_ns=self.edge[0] + least_ns, latest_ns=self.edge[1] + most_ns
        )
        return StartOptions(lead_ns=lead_ns, wait=wait)
