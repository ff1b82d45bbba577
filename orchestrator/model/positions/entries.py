"""Named positions as they are kept and listed, and the requests about them, on `svc/{verb}`."""

from typing import Annotated, Literal

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.fleet import MAX_DESCRIPTION
from orchestrator.model.messages import Reply, Request
from orchestrator.model.names import POSITION_NAME
from orchestrator.model.text.text_fields import SHOW_TEXT
from orchestrator.model.units import Quantity

PositionName = Annotated[str, Field(pattern=rf"^{POSITION_NAME}$")]


class SavedPosition(Model):
    """A position that was saved at run time. axes: user positions with their units, by axis."""

    name: PositionName
    axes: dict[str, str] = Field(min_length=1)
    description: Annotated[str, SHOW_TEXT] = Field(default="", max_length=MAX_DESCRIPTION)
    actor: str
    utc: str


class PositionEntry(Model):
    """A named position in a list. In user positions, like the targets of jobs.

    source: the fleet file, or saved at run time, by `actor` at `utc`. covers_file: the fleet file has a position of
    this name, which does not count while this one is there. problems: why a job that uses it would be refused.
    """

    name: str
    axes: dict[str, Quantity]
    description: str = ""
    source: Literal["file", "saved"]
    actor: str | None = None
    utc: str | None = None
    covers_file: bool = False
    problems: list[str] = Field(default=[])


class PositionsListed(Reply):
    """All named positions, those of the fleet file first."""

    positions: list[PositionEntry] = Field(default=[])


class SavePosition(Request):
    """Save a position under a name; an earlier saved one of this name is replaced.

    axes: axes, groups or controllers whose present user positions are saved; neither `axes` nor `values`: all axes that
    are referenced. values: user positions that are given, by axis. description: None keeps that of the earlier one.
    """

    name: str = Field(max_length=200)
    axes: list[str] = Field(default=[], max_length=10_000)
    values: dict[str, Quantity] = Field(default={}, max_length=10_000)
    description: Annotated[str, SHOW_TEXT] | None = Field(default=None, max_length=MAX_DESCRIPTION)


class PositionSaved(Reply):
    """position: as it is saved. replaced: the saved one before, if there was one."""

    position: PositionEntry | None = None
    replaced: PositionEntry | None = None


class RemovePosition(Request):
    """Remove a saved position; one of the fleet file with the same name counts again."""

    name: str = Field(max_length=200)


class PositionRemoved(Reply):
    """uncovered: the position of the fleet file that counts again, if there is one."""

    uncovered: PositionEntry | None = None
