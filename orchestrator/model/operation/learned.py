"""What a coordinator has learned of the times of its fleet, as it is kept in the journal."""

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.messages import Request
from orchestrator.model.queue import Utc

FLEET = ""
"""Stands for a controller in what was learned of the fleet as a whole."""


class LearnedTimes(Model):
    """What was learned of one controller, or of the whole fleet (`FLEET`).

    digest: of the configuration with which it was learned. utc: when. shares: of a controller, by kind of arming, the
    largest part of its declared time that it has needed of late. durations_ns: of the fleet, by activity, the longest
    of late.
    """

    controller: str
    digest: str
    utc: Utc
    shares: dict[str, float] = Field(default={})
    durations_ns: dict[str, float] = Field(default={})


class ForgetTimes(Request):
    """Forget the learned times of controllers; an empty list stands for all, and for the fleet as a whole."""

    controllers: list[str] = Field(max_length=10_000)
