"""A job's place in the queue: when it may begin, and its order; and what a fleet asks of the journal that keeps it.

The job itself describes the motion."""

from datetime import UTC, datetime, timedelta
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from orchestrator.model.base import Model
from orchestrator.model.numbers import Duration
from orchestrator.model.script import ScriptModel

NS_PER_S = 1_000_000_000

SESSION_PATTERN = r"^[a-z0-9_-]{1,64}$"
SIGN_PERIOD_NS = 200_000_000
"""Period of the signs of life of a session, the command that a person waits for."""
SESSION_TIMEOUT_NS = 1_000_000_000
"""A session without a sign of life for this long is over: five signs are missing."""

APPROVAL = "approval"
"""What holds a proposed job while its plan is not approved."""
WAITS_FOR_APPROVAL = "waits for approval: its plan is released with `tutti job approve`"

MAX_STEPS = 10_000  # in the report of a job, with all repeats; a scan counts as one
MAX_FLAT_STEPS = 100_000_000  # of a job: every pass, every point with the steps at it


def parse_utc(text: str) -> datetime:
    """Parse RFC 3339 text. Raises `ValueError` for other text, and for a time without an offset."""
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"{text!r} is not an RFC 3339 time; write e.g. 2026-11-21T22:00:00+01:00") from None
    if instant.tzinfo is None:
        raise ValueError(f"{text!r} has no offset from UTC; write e.g. {text}Z or {text}+01:00")
    try:
        return instant.astimezone(UTC)
    except OverflowError:
        raise ValueError(f"{text!r} is outside the calendar") from None


def format_utc(instant: datetime) -> str:
    """Format as RFC 3339 UTC with microseconds, like `Clock.utc`: the texts sort in the order of their instants."""
    return instant.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ").rjust(27, "0")


def shift_utc(utc: str, seconds: float) -> str:
    """The RFC 3339 instant so many seconds after `utc`."""
    return format_utc(parse_utc(utc) + timedelta(seconds=seconds))


def _in_utc(value: object) -> object:
    return format_utc(parse_utc(value)) if isinstance(value, str) else value


Utc = Annotated[str, BeforeValidator(_in_utc)]
"""An RFC 3339 instant, kept as UTC with microseconds."""


class QueueTerms(ScriptModel):
    """Queue options that are given at submission."""

    priority: int = Field(default=0, ge=-100, le=100, description="Higher ones come first.")
    repeat: int = Field(
        default=1, ge=1, le=MAX_STEPS, description="How often its steps are run, one run after the other."
    )
    after: str | None = Field(default=None, max_length=64, description="Id of the job that must be done before.")
    at: Utc | None = Field(default=None, description="Not before this time.")
    missed: Literal["run", "skip"] = Field(
        default="skip", description="Whether to run or skip it if no leader was active at its time."
    )
    held: bool = Field(default=False, description="It waits until it is released.")
    now: bool = Field(default=False, description="Refuse it instead of letting it wait.")
    expires: Utc | None = Field(default=None, description="Cancel it if it has not begun at this time.")
    session: str | None = Field(
        default=None,
        pattern=SESSION_PATTERN,
        description="The session of the command that a person waits for. The job begins although the queue is "
        "stopped, and ends when the session does.",
    )
    proposed: bool = Field(default=False, description="It waits for the approval of its plan.")
    continues: str | None = Field(
        default=None, max_length=64, description="Id of the job that it goes on with, from the place where it stood."
    )


class QueueStop(Model):
    """Since when, why and by which request or event no job of the queue begins."""

    reason: str
    actor: str
    utc: str


CopyMode = Literal["one copy", "two copies", "waits for a copy"]
"""On how many machines what is promised stands. `waits for a copy`: the fleet file asks for two, and one is missing."""


class JournalPolicy(Model):
    """The journal in a database (`--journal postgresql://…`). One in a file on this computer takes no notice of it."""

    copies: Literal[1, 2] = Field(
        default=1,
        description="2: a job is accepted once it is on two machines, by the database's synchronous standby.",
    )
    lease: Duration = Field(
        default=3 * NS_PER_S,
        ge=NS_PER_S,
        le=60 * NS_PER_S,
        description="A leader that cannot renew its lease ends after two thirds of it; a standby waits for the whole.",
    )


class StartPolicy(Model):
    """How starts that several controllers agree on are prepared."""

    release: Duration = Field(
        default=0,
        ge=0,
        le=10 * NS_PER_S,
        description="The least time for decision and release, before T0. A computer that is busy for less makes no "
        "start late; each start comes up to so much later. 0: what the fleet has needed of late.",
    )
