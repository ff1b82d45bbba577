"""Bench for test vectors of the SMC (section 18)."""

from collections.abc import Mapping
from typing import Literal

from pydantic import BaseModel, ConfigDict

from orchestrator.clock.base import Clock
from sim.core.controller import LimitSwitch
from sim.ppsmc.controller import PpsmcController, build_controller
from sim.ppsmc.options import read_options
from sim.ppsmc.sensors import TravelSwitch

_IDEAL = {"in_poll_ms": 0.0, "line_gap_ms": 0.0, "start_skew_us": 0.0, "reset_s": 0.0}
"""Vectors ignore these delays."""


class _GivenState(BaseModel):
    """Ground truth of a vector; positions are in the axis's unit, encoders in increments."""

    model_config = ConfigDict(extra="forbid")

    position: dict[str, float] = {}
    encoder: dict[str, int] = {}
    inputs: dict[int, bool] = {}
    outputs: dict[int, bool] = {}
    limits: dict[str, LimitSwitch] = {}
    home: dict[str, bool] = {}
    referenced: dict[str, bool] = {}
    stalled: list[str] = []
    error: dict[Literal["oscillation"], bool] = {}
    power: Literal["cycle"] | None = None


class PpsmcBench:
    """A controller without delays, with the handles that vectors need."""

    def __init__(self, clock: Clock, options: Mapping[str, object]) -> None:
        self._options = read_options({**_IDEAL, **options})
        self._controller = build_controller(clock, self._options, None, None, 0)

    @property
    def controller(self) -> PpsmcController:
        return self._controller

    @property
    def port_name(self) -> str:
        return self._options.link

    def apply_given(self, state: Mapping[str, object]) -> None:
        """Set up the state of a vector's `given` or of a `setup` step."""
        given_state = _GivenState.model_validate(dict(state))
        if given_state.power is not None:
            self._controller.set_power(on=False)
            self._controller.set_power(on=True)
        self._apply_positions(given_state)
        self._apply_signals(given_state)
        self._apply_conditions(given_state)

    def _apply_positions(self, stated: _GivenState) -> None:
        controller = self._controller
        for name, position in stated.position.items():
            axis = controller.find_axis(name)
            axis.set_counter(round(position * float(axis.settings.steps_per_unit)))
        for name, increments in stated.encoder.items():
            axis = controller.find_axis(name)
            if axis.encoder is None:
                raise ValueError("encoder: the axes have none; set option 'encoder'")
            axis.encoder.load_counter(increments, axis.steps - axis.origin)

    def _apply_signals(self, stated: _GivenState) -> None:
        controller, machine = self._controller, self._controller.machine
        for number, level in stated.inputs.items():
            controller.set_input(number, level=level)
        for number, level in stated.outputs.items():
            machine.output_byte = machine.output_byte & ~(1 << number) | level << number
        for name, switches in stated.limits.items():
            controller.set_limit(name, switches)
        for name, on in stated.home.items():
            axis = controller.find_axis(name)
            axis.switches.held[TravelSwitch.ORG] = on
            machine.rearm_axis(axis)

    def _apply_conditions(self, stated: _GivenState) -> None:
        controller = self._controller
        for name, on in stated.referenced.items():
            controller.find_axis(name).referenced = on
        for name in stated.stalled:
            controller.set_stalled(name, stalled=True)
        if stated.error.get("oscillation"):
            for axis in controller.machine.axes:
                axis.oscillation_error = True

    def is_refusal(self, reply: bytes) -> bool:
        """Return whether the reply is a refusal: silence, or with echo 1 and 2 an error message."""
        return not reply.strip() or reply.startswith(b"error")
