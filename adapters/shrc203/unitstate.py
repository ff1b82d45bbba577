"""What the driver knows of the unit between two commands."""

import asyncio
from dataclasses import dataclass, field

from adapters.shrc203.buffers import Buffers
from adapters.shrc203.session import Session


@dataclass(slots=True)
class UnitState:
    """One connection to one unit. excited: last known, by motor. sentinel: query and the reply that it must have.

    untidy: a stop may have left something in the prebuffers. loading: held by whoever fills or empties them.
    """

    session: Session
    controllable: tuple[int, ...] = ()
    excited: dict[int, bool] = field(default_factory=dict[int, bool])
    closed_loop: bool = False
    sentinel: tuple[str, str] = ("", "")
    untidy: bool = False
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)

    @property
    def buffers(self) -> Buffers:
        return Buffers(self.session, self.controllable)
