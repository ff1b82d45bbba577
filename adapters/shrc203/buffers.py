"""The unit's prebuffers: reading what is queued, and making it harmless.

No command deletes what is queued (L205): it is overwritten with a move of no distance. A standby (WT:, WI:) must
never be cancelled before what is queued behind it is overwritten, because cancelling starts it (L215, L219).
"""

from adapters.contract import DriverFault
from adapters.shrc203.axes import letter
from adapters.shrc203.replies import NOT_SET, STATUS, amounts, entries, status
from adapters.shrc203.session import Session
from adapters.shrc203.status import ERRORS

_TRIES = 2


class Buffers:
    """The prebuffers of the controllable axes of one unit."""

    def __init__(self, session: Session, controllable: tuple[int, ...]) -> None:
        self._session = session
        self._controllable = controllable

    async def moves(self) -> dict[int, int | None]:
        """The relative moves (MP:) that are queued, in pulses, by motor."""
        return await self._queued("?:MPW")

    async def waits(self) -> dict[int, int | None]:
        """The input patterns (WI:) that are queued, by motor."""
        return await self._queued("?:WIW")

    async def _queued(self, query: str) -> dict[int, int | None]:
        found = entries(await self._session.ask(query, amounts(len(self._controllable))))
        return dict(zip(self._controllable, found, strict=True))

    async def line(self) -> str:
        """The linear interpolation (KP:) that is queued, as the unit words it; `NS` for none."""
        return await self._session.ask("?:KP", NOT_SET)

    async def dangerous(self, besides: dict[int, int] | None = None, line: str = "NS") -> set[int]:
        """Motors that a `G:` would move. besides: distances that are meant to be there, by motor; line: the same of an
        interpolation."""
        meant = besides or {}
        found = {motor for motor, each in (await self.moves()).items() if (each or 0) != meant.get(motor, 0)}
        for query in ("?:APW", "?:WTW", "?:WIW"):
            found |= {motor for motor, each in (await self._queued(query)).items() if each is not None}
        if await self._session.ask("?:EP", NOT_SET) != "NS" or await self.line() != line:
            found |= set(self._controllable)
        return found

    async def clear(self, motors: set[int]) -> None:
        """Overwrite what is queued on `motors`. Refused by the unit while their excitation is off."""
        for each in sorted(motors):
            await self._session.try_to_tell(f"MP:{each}+P0")

    async def make_harmless(self, excited: dict[int, bool]) -> bool:
        """See to it that nothing queued can move an axis. Never starts a move. Whether nothing is left there.

        What is queued on an axis without excitation stays: it can not start (L4777, L4822), and is overwritten when the
        motor is switched on. So does what is queued on an axis in an error, which takes nothing and does not start
        before the error has been cleared. Raises `DriverFault` (code `still-armed`).
        """
        for _ in range(_TRIES):
            found = {each for each in await self.dangerous() if excited.get(each, True)}
            if not found:
                return True
            await self.clear(found)
        found = {each for each in await self.dangerous() if excited.get(each, True)}
        if not found:
            return True
        now = status(await self._session.ask("Q:SPC", STATUS), self._controllable)
        found -= {motor for motor, each in now.items() if each.word & ERRORS}
        if found:
            raise DriverFault(
                "still-armed",
                f"the unit keeps a queued move on axis {letter(found)} although it was overwritten",
                "switch the unit off and on",
            )
        return False

    async def end_standby(self, busy: set[int]) -> None:
        """End standbys that somebody left on `busy` axes, without starting what is queued behind them."""
        for each in sorted(busy):
            await self._session.try_to_tell(f"MP:{each}+P0")
            if (await self.moves())[each]:
                continue  # not overwritten, as in a motor that is off: do not cancel
            await self._session.try_to_tell(f"WI:{each},C")
            await self._session.try_to_tell(f"WT:{each},0")
