"""Approval of proposed jobs: what a job would do as a plan with a hash, and the requests about it, on `svc/{verb}`."""

import hashlib
import json
from collections.abc import Mapping
from typing import Annotated, Self

from pydantic import Field, model_validator

from orchestrator.model.base import Model
from orchestrator.model.jobs.service import JobReference
from orchestrator.model.messages import Reply
from orchestrator.model.steps.points import DIGEST_PATTERN

MAX_WORDS = 5  # changes that a sentence names

PlanHash = Annotated[str, Field(pattern=DIGEST_PATTERN)]


class JobPlan(Model):
    """What a job would do if it began now, and all that this depends on.

    parts: texts for people, by name: `{"position sample of gantry.x": "120 mm"}`. hash: of the parts; the same hash is
    the same plan.
    """

    hash: PlanHash
    parts: dict[str, str]

    @classmethod
    def of(cls, parts: Mapping[str, str]) -> Self:
        """The plan with these parts."""
        return cls(hash=_find_hash(parts), parts=dict(parts))

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.hash != _find_hash(self.parts):
            raise ValueError("the hash is not that of the parts")
        return self


def _find_hash(parts: Mapping[str, str]) -> str:
    text = json.dumps(dict(parts), sort_keys=True, separators=(",", ":"))
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


class JobApproval(Model):
    """The approval of a plan by a user. void: why it counts no longer; empty: it counts."""

    job_id: str
    plan: JobPlan
    actor: str
    utc: str
    void: str = ""


class JobPlanned(Reply):
    """plan: as it is now. changed: what differs from the plan that was approved last, in words."""

    plan: JobPlan | None = None
    changed: list[str] = Field(default=[])


class ApproveJob(JobReference):
    """Approve the plan of a proposed job, and release the job. plan: the hash of the plan that the user has seen."""

    plan: PlanHash


def list_changes(before: JobPlan, after: JobPlan) -> list[str]:
    """What differs between two plans, part by part, in words."""
    changes: list[str] = []
    for name in dict.fromkeys((*before.parts, *after.parts)):
        old_part, new_part = before.parts.get(name), after.parts.get(name)
        if old_part is None:
            changes.append(f"{name} is new: {new_part}")
        elif new_part is None:
            changes.append(f"{name} was {old_part}, and is gone")
        elif old_part != new_part:
            changes.append(f"{name} was {old_part}, is {new_part}")
    return changes


def join_changes(changes: list[str]) -> str:
    """Changes as one sentence; of many, the first ones."""
    more = len(changes) - MAX_WORDS
    return "; ".join(changes[:MAX_WORDS]) + (f"; and {more} more" if more > 0 else "")
