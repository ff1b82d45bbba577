"""A state of a controller, for tests that need one and care for few of its fields."""

from collections.abc import Mapping

from orchestrator.model.state import AxisState, ControllerState, Mode


def make_controller_state(
    controller: str,
    axes: Mapping[str, AxisState] | None = None,
    mode: Mode = "idle",
    leases: Mapping[str, str] | None = None,
) -> ControllerState:
    """A first state, without faults, clock, inputs and outputs."""
    return ControllerState(
        controller=controller,
        instance="i",
        seq=1,
        utc="",
        fleet_ns=None,
        mode=mode,
        axes=dict(axes or {}),
        inputs={},
        outputs={},
        faults=[],
        clock=None,
        estop=None,
        epoch=1,
        digest="d",
        leases=dict(leases or {}),
    )
