"""What the fault campaign has to know of a make. A simulator states it as its attribute `campaign`; without it, the
make has none of these properties."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from random import Random
from typing import Any, Literal, Protocol, cast

from orchestrator.model.fleet import Controller
from orchestrator.model.state import StartClass


class SecondMaster(Protocol):
    """The bytes by which a second client changes one thing of a controller."""

    def __call__(self, config: Controller, draw: Random, *, at_rest: bool) -> bytes: ...


@dataclass(frozen=True, slots=True)
class TouchInput:
    """An input that stops an axis. stops_by: what does that; a controller that captures the contact may leave it to
    its computer. line_motor: of a further axis, with which the controller stops on a line; None: it stops one alone."""

    number: int
    active: Literal["low", "high"]
    stops_by: Literal["controller", "computer", "host"]
    line_motor: str | None = None


@dataclass(frozen=True, slots=True)
class BeamCarrier:
    """An axis with a watchdog, which finds an index near by. options, homing, simulate: fields of its controller, of
    its axis, and of its simulator."""

    options: Mapping[str, Any]
    homing: Mapping[str, Any]
    simulate: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class BodyCarrier:
    """An axis in mm that carries a body, and finds the same reference each time. homing, simulate: fields of the axis,
    and of its simulator, for that."""

    homing: Mapping[str, Any] = field(default_factory=dict[str, Any])
    simulate: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True, slots=True)
class CampaignTraits:
    """Properties of a make for the fault campaign.

    refuse_reply: makes the reply of a controller that refuses everything from its normal reply; None: a refused command
    gets no reply, the same as a lost command.
    most_per_link: largest number of controllers on one link in a fleet of the campaign.
    start_class: a start class that jobs of controllers of this make alone may request.
    starts_link_together: one broadcast starts all loaded moves on a link.
    references_at_limit: the limit switch that is pressed may be its reference.
    verifies_reference: a controller with a reference verifies its position when it is homed, and does not move.
    keeps_half_open: it keeps connections that were cut without a close.
    change_one_thing: what a second client sends; None: it has no other connection.
    touch: the input of its controllers that a probe is stopped by; None: the campaign probes with none.
    beam: how one of its axes carries a beam with that of another controller; None: the campaign has none such.
    body: how one of its axes carries a body of a keep-out zone; None: the campaign has none such.
    loads: whether a request loads a move, on a link whose answers can be late; None: none can.
    """

    refuse_reply: Callable[[bytes], bytes] | None = None
    most_per_link: int = 1
    start_class: StartClass | None = None
    starts_link_together: bool = False
    references_at_limit: bool = False
    verifies_reference: bool = False
    keeps_half_open: bool = False
    change_one_thing: SecondMaster | None = None
    touch: TouchInput | None = None
    beam: BeamCarrier | None = None
    body: BodyCarrier | None = None
    loads: Callable[[bytes], bool] | None = None


def campaign_traits(simulator: object) -> CampaignTraits:
    """Return what a simulator states, or the usual properties."""
    return cast(CampaignTraits, getattr(cast(Any, simulator), "campaign", CampaignTraits()))
