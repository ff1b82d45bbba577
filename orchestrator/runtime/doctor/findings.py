"""What a check of a computer has found."""

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "failed"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One result. check: what was looked at. remedy: what to do; empty if nothing."""

    check: str
    state: State
    text: str
    remedy: str = ""
