"""The simulated JVL SMC30 step motor controller, alone or up to seven on one serial bus."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from orchestrator.clock.base import Clock
from orchestrator.model.fleet import Controller
from sim.core.campaign import BodyCarrier, CampaignTraits, TouchInput
from sim.core.controller import DeviceSpec, FirmwareTiming
from sim.core.oscillator import Oscillator
from sim.smc30.bench import Smc30Bench
from sim.smc30.bus import BusDevice, build_bus
from sim.smc30.commissioning import make_options
from sim.smc30.controller import Smc30Controller, build_controller
from sim.smc30.framing import compute_checksum
from sim.smc30.options import Smc30Options, read_options


def _refuse_reply(data: bytes) -> bytes:
    return b"E4" + bytes((compute_checksum(b"E4"),)) + b"\r" if data.endswith(b"\r") else data


class Smc30Simulator:
    """The model as the group `tutti.simulators` refers to it, alone or several on one line."""

    campaign = CampaignTraits(
        refuse_reply=_refuse_reply,
        most_per_link=2,
        start_class="host",
        starts_link_together=True,
        references_at_limit=True,
        touch=TouchInput(2, "high", "controller"),
        body=BodyCarrier(),
    )

    @property
    def model(self) -> str:
        return "smc30"

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> Smc30Controller:
        """Build a powered-up controller; `ValueError` for a wrong option."""
        return build_controller(clock, read_options(options), oscillator, timing, seed)

    @property
    def options_model(self) -> type[BaseModel]:
        return Smc30Options

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file."""
        return make_options(config, expected)

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> Smc30Bench:
        """Build a controller whose firmware takes no time unless the options say otherwise."""
        return Smc30Bench(build_controller(clock, read_options(options, ideal=True), None, None, 0))

    def build_shared(self, clock: Clock, devices: Sequence[DeviceSpec]) -> tuple[Smc30Controller, Sequence[BusDevice]]:
        """Build devices with addresses on one line; `ValueError` for a wrong option."""
        return build_bus(clock, devices)


SMC30 = Smc30Simulator()
