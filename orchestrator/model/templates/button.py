"""The button of a job file: how the operators' page offers the job by one press.

It is a part of the file, not of the job: nothing that plans, compares or carries out a job depends on it.
"""

from typing import Annotated

from pydantic import AfterValidator, Field

from orchestrator.model.base import Model
from orchestrator.model.templates.references import MARK

MAX_LABEL, MAX_GROUP = 40, 40  # characters: a longer text is not legible on a button


def _check_text(text: str) -> str:
    """A text that is seen as it is written. Raises `ValueError`."""
    if not text.strip():
        raise ValueError("must have a character that is seen, for example `Park`")
    unseen = next((character for character in text if not character.isprintable()), None)
    if unseen is not None:
        raise ValueError(f"has the character U+{ord(unseen):04X}, which cannot be seen; remove it")
    if MARK in text:
        raise ValueError("has a parameter, and a button is shown before parameters have values; write a fixed text")
    return text.strip()


class JobButton(Model):
    """A button of the operators' page, in *Run* and *Set-up*: with parameters it opens their form, without it submits
    the job."""

    label: Annotated[str, AfterValidator(_check_text)] = Field(max_length=MAX_LABEL, description="The text on it.")
    group: Annotated[str, AfterValidator(_check_text)] | None = Field(
        default=None, max_length=MAX_GROUP, description="Buttons of one group stand under its name."
    )


class ButtonDeclaration(Model):
    """The part of a job file that makes a button of it."""

    button: JobButton | None = Field(default=None, description="Offers the job as a button of the operators' page.")
