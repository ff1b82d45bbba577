"""The SMC-4000: up to four axes, TCP, UDP and serial (L24-L55, L1719)."""

from collections.abc import Mapping

from orchestrator.clock.base import Clock
from sim.core.controller import Timing
from sim.core.oscillator import Oscillator
from sim.yaskawa.controller import Bench, Controller
from sim.yaskawa.dialect import COMMANDS
from sim.yaskawa.machine import Machine
from sim.yaskawa.model import Model
from sim.yaskawa.options import Options

MODEL = Model(
    name="smc4000",
    revision="SMC4040 Rev 1.0a",
    ports=("tcp", "udp", "serial"),
    commands=COMMANDS,
)


class Smc4000Simulator:
    """Builds simulated SMC-4000 controllers; fulfils `Simulator`."""

    @property
    def model(self) -> str:
        return MODEL.name

    def build(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: Timing | None = None,
        seed: int = 0,
    ) -> Controller:
        """A powered-up controller. Options are the fields of `Options`; `ValueError` names a wrong one."""
        chosen = Options.model_validate(dict(options))
        machine = Machine(clock, MODEL, chosen, oscillator or Oscillator(), timing or Timing(), seed)
        usual = (chosen.link, *(port for port in MODEL.ports if port != chosen.link))
        machine.go_on()
        return Controller(machine, usual)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> Bench:
        """The same, ideal in time, with the handles that test vectors need."""
        return Bench(self.build(clock, options))


SMC4000 = Smc4000Simulator()
