"""The simulated OptoSigma SHRC-203 three-axis stage controller, command format SHOT/FC."""

from collections.abc import Mapping

from orchestrator.clock.base import Clock
from sim.core.controller import Simulator, Timing
from sim.core.oscillator import Oscillator
from sim.shrc203.bench import Bench
from sim.shrc203.controller import Shrc203Controller, build_controller
from sim.shrc203.options import read_options


class _Shrc203:
    """The model, as the group `tutti.simulators` names it."""

    @property
    def model(self) -> str:
        return "shrc203"

    def build(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: Timing | None = None,
        seed: int = 0,
    ) -> Shrc203Controller:
        """A powered-up controller; `ValueError` for a wrong option."""
        return build_controller(clock, read_options(options), oscillator, timing, seed)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> Bench:
        """The same, ideal in time."""
        return Bench(build_controller(clock, read_options(options), None, None, None))


SHRC203: Simulator = _Shrc203()
