"""Bench for test vectors of the SMC30."""

from collections.abc import Mapping
from typing import Literal

from pydantic import BaseModel, ConfigDict

from sim.core.controller import LimitSwitch
from sim.smc30.controller import Smc30Controller


class _GivenState(BaseModel):
    """Ground truth of a vector: positions in steps, analogue inputs in volts."""

    model_config = ConfigDict(extra="forbid")

    position: dict[str, int] = {}
    inputs: dict[int, bool] = {}
    analog: dict[int, float] = {}
    outputs: dict[int, bool] = {}
    limits: dict[str, LimitSwitch] = {}
    stalled: list[str] = []
    power: Literal["cycle"] | None = None


class Smc30Bench:
    """A controller without delays, with the handles that vectors need."""

    def __init__(self, controller: Smc30Controller) -> None:
        self._controller = controller

    @property
    def controller(self) -> Smc30Controller:
        return self._controller

    @property
    def port_name(self) -> str:
        return "serial"

    def apply_given(self, state: Mapping[str, object]) -> None:
        """Set up the state of a vector's `given` or of a `setup` step."""
        given_state = _GivenState.model_validate(dict(state))
        controller = self._controller
        if given_state.power is not None:
            controller.set_power(on=False)
            controller.set_power(on=True)
        for axis, counter in given_state.position.items():
            controller.find_indexer(axis).drive.set_counter(counter)
        for number, level in given_state.inputs.items():
            controller.set_input(number, level=level)
        for number, volts in given_state.analog.items():
            controller.set_analog(number, volts)
        for number, level in given_state.outputs.items():
            controller.set_output(number, level=level)
        for axis, switches in given_state.limits.items():
            controller.set_limit(axis, switches)
        for axis in given_state.stalled:
            controller.set_stalled(axis, stalled=True)

    def is_refusal(self, reply: bytes) -> bool:
        """Return whether one of the answers is an error, or B (not accepted)."""
        return any(line[:1] in (b"E", b"B") for line in reply.split(b"\r"))
