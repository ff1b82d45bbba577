"""The unit's prebuffers: reading what is queued, and making it harmless.

No command deletes what is queued (L205): it is overwritten with a move of no distance. A standby (WT:, WI:) must
never be cancelled before what is queued behind it is overwritten, because cancelling starts it (L215, L219).
"""

from adapters.contract import DriverFault
from adapters.shrc203.axes import letter
from adapters.shrc203.replies import NOT_SET, amounts, entries
from adapters.shrc203.session import Session

_TRIES = 2


class Buffers:
    """The prebuffers of the controllable axes of one unit."""

    def __init__(self, session: Session, controllable: tuple[int, ...]) -> None:
        self._session = session
        self._controllable = controllable

    async def dangerous(self, besides: dict[int, int] | None = None) -> set[int]:
        """Motors that a `G:` would move. besides: distances that are meant to be there, by motor."""
        meant, count = besides or {}, len(self._controllable)
        moves = entries(await self._session.ask("?:MPW", amounts(count)))
        found = {m for m, each in zip(self._controllable, moves, strict=True) if (each or 0) != meant.get(m, 0)}
        for query in ("?:APW", "?:WTW", "?:WIW"):
            others = entries(await self._session.ask(query, amounts(count)))
            found |= {m for m, each in zip(self._controllable, others, strict=True) if each is not None}
        for query in ("?:EP", "?:KP"):
            if await self._session.ask(query, NOT_SET) != "NS":
                found |= set(self._controllable)
        return found

    async def clear(self, motors: set[int]) -> None:
        """Overwrite what is queued on `motors`. Refused by the unit while their excitation is off."""
        for each in sorted(motors):
            await self._session.try_to_tell(f"MP:{each}+P0")

    async def make_harmless(self, excited: dict[int, bool]) -> None:
        """See to it that nothing queued can move an axis. Never starts a move.

        What is queued on an axis without excitation stays: it can not start (L4777, L4822), and is overwritten when the
        motor is switched on. Raises `DriverFault` (code `still-armed`).
        """
        for _ in range(_TRIES):
            found = {each for each in await self.dangerous() if excited.get(each, True)}
            if not found:
                return
            await self.clear(found)
        found = {each for each in await self.dangerous() if excited.get(each, True)}
        if found:
            raise DriverFault(
                "still-armed",
                f"the unit keeps a queued move on axis {letter(found)} although it was overwritten",
                "switch the unit off and on",
            )

    async def end_standby(self, busy: set[int]) -> None:
        """End standbys that somebody left on `busy` axes, without starting what is queued behind them."""
        for each in sorted(busy):
            await self._session.try_to_tell(f"MP:{each}+P0")
            if entries(await self._session.ask("?:MPW", amounts(len(self._controllable))))[
                self._controllable.index(each)
            ]:
                continue  # not overwritten, as in a motor that is off: do not cancel
            await self._session.try_to_tell(f"WI:{each},C")
            await self._session.try_to_tell(f"WT:{each},0")
