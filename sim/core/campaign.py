"""What the fault campaign has to know of a make. A simulator states it as its attribute `campaign`; without it, the
make has none of these properties."""

from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Any, Protocol, cast

from orchestrator.model.fleet import Controller
from orchestrator.model.state import StartClass


class SecondMaster(Protocol):
    """The bytes by which a second client changes one thing of a controller."""

    def __call__(self, config: Controller, draw: Random, *, at_rest: bool) -> bytes: ...


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
    """

    refuse_reply: Callable[[bytes], bytes] | None = None
    most_per_link: int = 1
    start_class: StartClass | None = None
    starts_link_together: bool = False
    references_at_limit: bool = False
    verifies_reference: bool = False
    keeps_half_open: bool = False
    change_one_thing: SecondMaster | None = None


def campaign_traits(simulator: object) -> CampaignTraits:
    """Return what a simulator states, or the usual properties."""
    return cast(CampaignTraits, getattr(cast(Any, simulator), "campaign", CampaignTraits()))
