"""Commands of users as the journal keeps them, and the request for them, on `svc/commands`."""

from typing import Annotated

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.messages import Reply, Request
from orchestrator.model.queue import Utc
from orchestrator.model.text.text_fields import SHOW_TEXT

MAX_LISTED = 1000  # commands in one reply


class CommandRecord(Model):
    """A command that changes something, as it was executed or refused.

    verb: of `svc/{verb}`. subject: what it was about: jobs, axes, alarms. refused: the code of the refusal; empty: it
    was executed.
    """

    utc: str
    actor: str
    verb: str
    subject: str
    refused: str


class ListCommands(Request):
    """List the newest commands; those before `before`, and those by users with this text in their name."""

    limit: int = Field(default=100, ge=1, le=MAX_LISTED)
    before: Utc | None = None
    by: Annotated[str, SHOW_TEXT] = Field(default="", max_length=128)


class CommandsListed(Reply):
    """The newest first. Fewer than the limit are all that are left."""

    commands: list[CommandRecord] = Field(default=[])
