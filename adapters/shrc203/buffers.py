"""The controller's prebuffers: reading the queued moves, and making them harmless.

No command deletes a queued move (L205): it is overwritten with a move of no distance. An input or timed wait (WT:, WI:)
must never be cancelled before the move queued after it is overwritten, because cancelling starts that move (L215,
L219).
"""

from adapters.shrc203.wire.replies import NOT_SET, STATUS, axis_argument, parse_entries, parse_status, pulse_list
from adapters.shrc203.wire.session import ShrcSession
from adapters.shrc203.wire.status import ERRORS
from orchestrator.model.errors import ControllerFault

_TRIES = 2


class PrebufferControl:
    """The prebuffers of the controllable axes of one controller."""

    def __init__(self, session: ShrcSession, controllable: tuple[int, ...]) -> None:
        self._session = session
        self._controllable = controllable

    async def read_moves(self) -> dict[int, int | None]:
        """Return the queued relative moves (MP:), in pulses, by motor."""
        return await self._read_queue("?:MPW")

    async def read_waits(self) -> dict[int, int | None]:
        """Return the queued input patterns (WI:), by motor."""
        return await self._read_queue("?:WIW")

    async def _read_queue(self, query: str) -> dict[int, int | None]:
        entries = parse_entries(await self._session.send_query(query, pulse_list(len(self._controllable))))
        return dict(zip(self._controllable, entries, strict=True))

    async def read_interpolation(self) -> str:
        """Return the queued linear interpolation (KP:) in the controller's notation; `NS` for none."""
        return await self._session.send_query("?:KP", NOT_SET)

    async def find_dangerous(self, intended: dict[int, int] | None = None, interpolation: str = "NS") -> set[int]:
        """Return the motors that a `G:` would move.

        intended: intended distances, by motor. interpolation: the intended interpolation."""
        intended_distances = intended or {}
        dangerous_motors = {
            motor
            for motor, distance in (await self.read_moves()).items()
            if (distance or 0) != intended_distances.get(motor, 0)
        }
        for query in ("?:APW", "?:WTW", "?:WIW"):
            dangerous_motors |= {motor for motor, entry in (await self._read_queue(query)).items() if entry is not None}
        if await self._session.send_query("?:EP", NOT_SET) != "NS" or await self.read_interpolation() != interpolation:
            dangerous_motors |= set(self._controllable)
        return dangerous_motors

    async def overwrite_moves(self, motors: set[int]) -> None:
        """Overwrite the queued moves of `motors`. The controller refuses this while their excitation is off."""
        for motor in sorted(motors):
            await self._session.try_setting(f"MP:{motor}+P0")

    async def make_harmless(self, excited: dict[int, bool]) -> bool:
        """Ensure that no queued move can move an axis, without starting one. Return whether the prebuffers are empty.

        A queued move of an axis without excitation stays: it cannot start (L4777, L4822), and is overwritten when the
        motor is switched on. So does a queued move of an axis in an error state, which accepts no command and does not
        start before the error is cleared. Raises `ControllerFault` (code `still-armed`).
        """
        for _ in range(_TRIES):
            dangerous_motors = {motor for motor in await self.find_dangerous() if excited.get(motor, True)}
            if not dangerous_motors:
                return True
            await self.overwrite_moves(dangerous_motors)
        dangerous_motors = {motor for motor in await self.find_dangerous() if excited.get(motor, True)}
        if not dangerous_motors:
            return True
        states = parse_status(await self._session.send_query("Q:SPC", STATUS), self._controllable)
        dangerous_motors -= {motor for motor, state in states.items() if state.word & ERRORS}
        if dangerous_motors:
            raise ControllerFault(
                "still-armed",
                f"the controller keeps a queued move on axis {axis_argument(dangerous_motors)} "
                "although it was overwritten",
                "switch the controller off and on",
            )
        return False

    async def end_input_waits(self, busy: set[int]) -> None:
        """End input waits left on `busy` axes, without starting the moves queued after them."""
        for motor in sorted(busy):
            await self._session.try_setting(f"MP:{motor}+P0")
            if (await self.read_moves())[motor]:
                continue  # not overwritten, as in a motor that is off: do not cancel
            await self._session.try_setting(f"WI:{motor},C")
            await self._session.try_setting(f"WT:{motor},0")
