"""Offsets of the positions that users see, set at rest and kept on disk."""

from collections.abc import Callable
from fractions import Fraction

from adapters.controller.publishing.publisher import StatePublisher
from adapters.controller.state.status import ControllerStatus
from adapters.controller.state.store import PersistentMemory
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import LeasedRequest, Reply, SetPositionRequest
from orchestrator.model.units import UnitError, parse_quantity


class AxisOffsets:
    """The offsets of one controller. require_idle: raises `Refusal` unless the requester may use its axes, and no step
    is loaded."""

    def __init__(
        self,
        status: ControllerStatus,
        remembered: PersistentMemory,
        publisher: StatePublisher,
        require_idle: Callable[[LeasedRequest], None],
    ) -> None:
        self._status = status
        self._remembered = remembered
        self._publisher = publisher
        self._require_idle = require_idle

    async def set_position(self, request: SetPositionRequest) -> Reply:
        """Give the present position another name, or its own again. Nothing moves. Raises `Refusal`, `OSError`."""
        self._require_idle(request)
        (name,) = request.axes
        axis, offsets = self._status.config.axes[name], dict(self._remembered.values.offsets)
        offsets.pop(name, None)
        if request.position is not None:
            counts = Fraction(self._status.require_online().axes[name].commanded_counts)
            play = self._status.play.find_play(name)
            motor = axis.to_position(counts if play is None else counts + play.middle)
            try:
                offsets[name] = parse_quantity(request.position, axis.unit) - motor
            except UnitError as error:
                raise Refusal("bad-unit", f"{name}: {error}") from None
        await self._remembered.store_values(offsets=offsets)
        self._publisher.publish_state()
        return Reply()
