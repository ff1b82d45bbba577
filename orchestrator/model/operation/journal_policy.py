"""What a fleet file asks of the journal, where that is in a database that other computers reach."""

from typing import Literal

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.numbers import Duration

NS_PER_S = 1_000_000_000

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
