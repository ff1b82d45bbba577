"""The simulated JVL SMC30 step motor controller, alone or up to seven on one serial bus."""

from collections.abc import Mapping, Sequence

from orchestrator.clock.base import Clock
from sim.core.controller import Branch, Timing
from sim.core.oscillator import Oscillator
from sim.smc30.bench import Bench
from sim.smc30.bus import BusUnit, build_bus
from sim.smc30.controller import Smc30Controller, build_controller
from sim.smc30.options import read_options


class Smc30:
    """The model, alone or several on one line, as the group `tutti.simulators` names it."""

    @property
    def model(self) -> str:
        return "smc30"

    def build(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: Timing | None = None,
        seed: int = 0,
    ) -> Smc30Controller:
        """A powered-up controller; `ValueError` for a wrong option."""
        return build_controller(clock, read_options(options), oscillator, timing, seed)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> Bench:
        """The same, with a firmware that takes no time unless the options say so."""
        return Bench(build_controller(clock, read_options(options, ideal=True), None, None, 0))

    def build_shared(self, clock: Clock, units: Sequence[Branch]) -> tuple[Smc30Controller, Sequence[BusUnit]]:
        """Units with addresses on one line; `ValueError` for a wrong option."""
        return build_bus(clock, units)


SMC30 = Smc30()
