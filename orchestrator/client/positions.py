"""Requests about named positions."""

from collections.abc import Mapping

from orchestrator.client.connection import FleetConnection
from orchestrator.model.messages import Request
from orchestrator.model.positions.entries import (
    PositionEntry,
    PositionRemoved,
    PositionSaved,
    PositionsListed,
    RemovePosition,
    SavePosition,
)


class PositionRequests(FleetConnection):
    """List, save and remove named positions. `move(to="sample")` moves to one."""

    async def list_positions(self) -> list[PositionEntry]:
        """All named positions: those of the fleet file, and those that are saved. Raises `Refusal`."""
        return (await self.request_service("positions", Request(**self.request_fields()), PositionsListed)).positions

    async def save_position(
        self,
        name: str,
        *axes: str,
        at: Mapping[str, int | float | str] | None = None,
        description: str | None = None,
    ) -> PositionEntry:
        """Save the present user positions of axes (groups, controllers) under a name; an earlier saved position of
        this name is replaced. Without axes and `at`: of all axes that are referenced.

        at: values that are given instead, by axis. Raises `Refusal`: codes `bad-name`, `moving`, `not-referenced`,
        `offline`, `unknown-name`, `bad-unit`, `soft-limit`.
        """
        request = SavePosition(
            **self.request_fields(), name=name, axes=list(axes), values=dict(at or {}), description=description
        )
        saved_position = (await self.request_service("save-position", request, PositionSaved)).position
        assert saved_position is not None
        return saved_position

    async def remove_position(self, name: str) -> PositionEntry | None:
        """Remove a saved position; return that of the fleet file with the same name, which counts again. Raises
        `Refusal`: codes `unknown-name`, `in-file`."""
        request = RemovePosition(**self.request_fields(), name=name)
        return (await self.request_service("remove-position", request, PositionRemoved)).uncovered
