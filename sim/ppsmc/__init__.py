"""The simulated pp-electronic SMC step-motor controller (also sold as Huber SMC 9000 and 9300)."""

from collections.abc import Mapping

from orchestrator.clock.base import Clock
from sim.core.controller import Simulator, Timing
from sim.core.oscillator import Oscillator
from sim.ppsmc.bench import Bench
from sim.ppsmc.controller import SmcController, build_controller
from sim.ppsmc.options import read_options


class _PpSmc:
    """The model, as the group `tutti.simulators` names it."""

    @property
    def model(self) -> str:
        return "ppsmc"

    def build(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: Timing | None = None,
        seed: int = 0,
    ) -> SmcController:
        """A powered-up controller; `ValueError` for a wrong option."""
        return build_controller(clock, read_options(options), oscillator, timing, seed)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> Bench:
        """The same, ideal in time."""
        return Bench(clock, options)


PPSMC: Simulator = _PpSmc()
