"""Settings that motion relies on, compared with what the controller holds now: its front panel, or another client, may
change them.

Not compared: the speeds of moves, which are a part of every move; the memory switches, which can only be read in a mode
of their own (L7333); mode and command format, of which any other makes the next poll fail.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from adapters.contract import SettingDifference
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import (
    CONTROLLABLE,
    SETTLING,
    ShrcReplyFormat,
    axis_argument,
    division_list,
    flag_list,
    size_list,
    speed_list,
)
from orchestrator.model.errors import Refusal


@dataclass(frozen=True, slots=True)
class WatchedQuery:
    """A query whose reply must stay the same.

    item: the setting in the controller's words. form: of its reply. per_axis: the reply is a list, by axis.
    restore: what writes the value of one axis (`{a}`), or of the controller, again (`{v}`); empty: nothing does.
    """

    query: str
    item: str
    form: ShrcReplyFormat
    per_axis: bool = False
    moves_reference: bool = False
    restore: str = ""
    remedy: str = ""


def _watched_queries(axes: int) -> tuple[WatchedQuery, ...]:
    """Return everything that is compared, with lists of `axes` entries."""
    switches = "correct the controller's memory switches, then switch it off and on"
    return (
        # The pulse length follows from the division (L807-L811), which is written first.
        WatchedQuery(
            "?:SW", "division (?:S)", division_list(axes), per_axis=True, moves_reference=True, restore="S:{a},{v}"
        ),
        WatchedQuery(
            "?:PW", "nm per pulse (?:P)", size_list(axes), per_axis=True, moves_reference=True, remedy=switches
        ),
        WatchedQuery("?:FW", "loop mode (?:F)", flag_list(axes), per_axis=True, restore="F:{a}{v}"),
        WatchedQuery("?:W", "settling wait (?:W)", SETTLING, restore="W:{v}"),
        WatchedQuery("?:BW", "origin return speeds (?:B)", speed_list(axes), per_axis=True, restore="B:{a}{v}"),
        WatchedQuery(
            "?:RW", "scale resolution (?:R)", size_list(axes), per_axis=True, moves_reference=True, remedy=switches
        ),
        WatchedQuery("?:AXIS", "controllable axes (?:AXIS)", CONTROLLABLE, remedy=switches),
    )


AT_ARM = ("?:PW", "?:FW")
"""Read before each step: where a move goes, and by what."""


class ShrcWatch:
    """The watched settings of one connection. motors: axis names by motor."""

    def __init__(self, unit: ShrcState, motors: Mapping[int, str]) -> None:
        self._unit = unit
        self._motors = motors
        self._queries: tuple[WatchedQuery, ...] = ()
        self._expected: dict[str, str] = {}
        self._next = 0
        self.has_differences = False
        """Whether a difference has been found since the settings were last in order."""

    async def record_settings(self) -> None:
        """Read what the controller holds now, after configuring: these replies are expected from now on.

        A query that is refused is not compared. Raises `ControllerFault`.
        """
        self._queries = _watched_queries(len(self._unit.controllable))
        self._expected = {}
        for watched_query in self._queries:
            reply = await self._unit.session.query_optional(watched_query.query, watched_query.form)
            if reply is not None:
                self._expected[watched_query.query] = reply
        self.has_differences = False

    async def check_motion(self) -> list[SettingDifference]:
        """Compare what determines where a move goes."""
        differences: list[SettingDifference] = []
        for watched_query in self._queries:
            if watched_query.query in AT_ARM:
                differences += await self._compare(watched_query)
        return differences

    async def check_next(self) -> list[SettingDifference]:
        """Compare the next query in turn."""
        if not self._queries:
            return []
        self._next = (self._next + 1) % len(self._queries)
        return await self._compare(self._queries[self._next])

    async def restore_settings(self) -> None:
        """Write the expected values again. Raises `Refusal`, `ControllerFault`."""
        if not self.has_differences:
            return
        session = self._unit.session
        for watched_query in self._queries:
            for difference in await self._compare(watched_query):
                if not watched_query.restore:
                    raise Refusal("setting-changed", difference.to_fault().text, difference.remedy)
                motor = next((m for m, name in self._motors.items() if name == difference.axis), None)
                command = watched_query.restore.format(
                    a="" if motor is None else axis_argument([motor]), v=difference.expected
                )
                await session.send_setting(command)
                session.log.info("a setting that was changed is written again", command=command)
            if await self._compare(watched_query):
                raise Refusal(
                    "setting-changed",
                    f"{watched_query.item} is not accepted again",
                    watched_query.remedy or "see its display",
                )
        self.has_differences = False

    # Internals

    async def _compare(self, watched: WatchedQuery) -> list[SettingDifference]:
        unit, expected_reply = self._unit, self._expected.get(watched.query)
        if expected_reply is None:
            return []
        # While a completion is outstanding a digit could be that.
        reply = await unit.session.query_digit(watched.query, watched.form)
        if reply is None or reply == expected_reply:
            return []
        if not watched.per_axis:
            pairs = [(None, reply, expected_reply)]
        else:
            entries = zip(unit.controllable, reply.split(","), expected_reply.split(","), strict=True)
            pairs = [
                (self._motors[motor], entry, expected_entry)
                for motor, entry, expected_entry in entries
                if motor in self._motors and entry != expected_entry
            ]
        differences = [
            SettingDifference(
                item=watched.item if name is None else f"{watched.item} of axis {name}",
                found=entry,
                expected=expected_entry,
                axis=name,
                moves_reference=watched.moves_reference,
                # A changed division changes the pulse length, and is written again before it.
                repairable=bool(watched.restore) or watched.query == "?:PW",
                remedy=watched.remedy,
            )
            for name, entry, expected_entry in pairs
        ]
        self.has_differences = self.has_differences or bool(differences)
        return differences
