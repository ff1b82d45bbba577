"""Bench for test vectors of the SHRC-203."""

from collections.abc import Mapping
from typing import Literal

from pydantic import BaseModel, ConfigDict

from sim.core.controller import LimitSwitch
from sim.shrc203.axis import StageAxis
from sim.shrc203.controller import Shrc203Controller
from sim.shrc203.inputs import bit_mask
from sim.shrc203.status import ERRORS


class _GivenState(BaseModel):
    """Ground truth of a vector; axis names are "1", "2", "3", positions are pulses."""

    model_config = ConfigDict(extra="forbid")

    position: dict[str, int] = {}
    encoder: dict[str, int] = {}
    inputs: dict[int, bool] = {}
    outputs: dict[int, bool] = {}
    limits: dict[str, LimitSwitch] = {}
    home: dict[str, bool] = {}
    motor_off: list[str] = []
    stalled: list[str] = []
    error: dict[str, list[str]] = {}
    """Device error (`S1`, …, `EMERGENCY`) to the axes that have it."""
    power: Literal["cycle"] | None = None


class Shrc203Bench:
    """A controller without delays, with the handles that vectors need."""

    def __init__(self, controller: Shrc203Controller) -> None:
        self._controller = controller

    @property
    def controller(self) -> Shrc203Controller:
        return self._controller

    @property
    def port_name(self) -> str:
        return "serial"

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
        for name, coordinate in stated.position.items():
            axis = self._find_axis(name)
            axis.position = coordinate - axis.offset
        for name, coordinate in stated.encoder.items():
            axis = self._find_axis(name)
            axis.scale_deviation = axis.position + axis.offset - coordinate

    def _apply_signals(self, stated: _GivenState) -> None:
        controller, unit = self._controller, self._controller.unit
        for number, level in stated.inputs.items():
            controller.set_input(number, level=level)
        for number, level in stated.outputs.items():
            value = unit.outputs.value
            unit.outputs.set_levels(value | bit_mask(number) if level else value & ~bit_mask(number))
        for name, switches in stated.limits.items():
            controller.set_limit(name, switches)
        for name, on in stated.home.items():
            self._find_axis(name).home_sensor = on

    def _apply_conditions(self, stated: _GivenState) -> None:
        for name in stated.motor_off:
            self._find_axis(name).excited = False
        for name in stated.stalled:
            self._controller.set_stalled(name, stalled=True)
        for error, names in stated.error.items():
            if error not in ERRORS:
                raise ValueError(f"no error {error!r}; there are {', '.join(sorted(ERRORS))}")
            for name in names:
                self._find_axis(name).errors.add(error)

    def is_refusal(self, reply: bytes) -> bool:
        return reply.strip() in (b"NG", b"NG_I")

    def _find_axis(self, name: str) -> StageAxis:
        for axis in self._controller.unit.axes:
            if axis.name == name:
                return axis
        raise ValueError(f"no axis {name!r}; there are {', '.join(self._controller.axis_names)}")
