"""The simulated CANopen drive with the profile CiA 402, alone or several on one bus. Its EDS file is `drive.eds`."""

from collections.abc import Mapping, Sequence

from orchestrator.clock.base import Clock
from sim.cia402.unit import DriveUnit, build_bus, build_drive
from sim.core.controller import Branch, Timing, VectorBench
from sim.core.oscillator import Oscillator
from sim.link.can_card import CanSegment


class Cia402:
    """The model as the group `tutti.simulators` names it."""

    @property
    def model(self) -> str:
        return "cia402"

    def build(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: Timing | None = None,
        seed: int = 0,
    ) -> DriveUnit:
        """A powered-up drive on a bus of its own; `ValueError` for a wrong option."""
        return build_drive(clock, options, oscillator, timing, seed)

    def build_shared(self, clock: Clock, units: Sequence[Branch]) -> tuple[CanSegment, Sequence[DriveUnit]]:
        """Drives on one bus, each a node; `ValueError` for a wrong option."""
        return build_bus(clock, units)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> VectorBench:
        """Vectors are lines of text; frames are not."""
        raise ValueError("the model cia402 has no test vectors: it speaks frames, not lines")


CIA402 = Cia402()
