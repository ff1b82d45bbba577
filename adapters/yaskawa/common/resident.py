"""The resident program in a controller: installed if it is not there, halted, and listed."""

from contextlib import suppress

from adapters.yaskawa.common import arrays
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import (
    EDGE_THREAD,
    OUTPUT_PASSIVE,
    PROBE_INPUT,
    VARIABLES,
    WATCHDOG_THREAD,
    axis_letters,
)
from adapters.yaskawa.shapes.model import LEAVE_CONTOUR
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.session import CommandSession
from orchestrator.model.errors import ControllerFault

THREADS = 8  # L12258
CONTOURING = 1 << 5  # of TB (L10224)


class ResidentProgram:
    """The resident program of one controller. step_threads: of a step, and of one that follows it."""

    def __init__(self, options: YaskawaOptions, step_threads: tuple[int, int]) -> None:
        self._options = options
        self._step_threads = step_threads
        self.lines: tuple[str, ...] = ()
        """None before it was installed."""

    async def install(self, session: CommandSession, program: tuple[str, ...], axes: int) -> None:
        """Install the program if the controller does not have it. axes: of the controller. Raises `ControllerFault`."""
        self.lines = program
        present = [line.rstrip() for line in await session.query_all("UL")]
        if present == list(program):
            # The adapter's own program may still wait for a start that will never be released, or play a contour to its
            # end.
            (status,), _ = await session.read_numbers("_TB")
            is_contour = bool(int(status) & CONTOURING)
            if is_contour or await self._is_probing(session):
                motion = "contour" if is_contour else "probe"
                session.log.warning(f"a {motion} of an earlier session is in progress; it is stopped by its ramps")
                # Without its program a contour would stop abruptly (L13968), and a probe would not stop at its contact.
                await session.send_command(f"ST{axis_letters((1 << axes) - 1)}" + ("" if is_contour else "S"))
            await self.unload(session)
        else:
            await self._require_replaceable(session, present)
            session.log.info("installing the resident program", lines=len(program), replaced=len(present))
            try:
                await session.download_program(program)
            except SmcCommandRefused as refusal:
                raise ControllerFault(
                    "program-refused",
                    f"the controller does not accept its program: {refusal}",
                    "is its program memory locked (LC), or is a download active on another of its ports?",
                ) from None
            if [line.rstrip() for line in await session.query_all("UL")] != list(program):
                raise ControllerFault(
                    "program-differs", "the program read back is not the one that was sent", "check the link; try again"
                )
        await session.send_settings(f"{name}=0" for name in VARIABLES)
        await arrays.free_arrays(session)

    async def unload(self, session: CommandSession) -> None:
        """Halt the program and leave contour mode: nothing starts, now or later."""
        threads = dict.fromkeys((*self._step_threads, WATCHDOG_THREAD, EDGE_THREAD))
        # Outside contour mode, or without a driven trigger line, the controller refuses the respective command.
        with suppress(SmcCommandRefused):
            await session.send_settings((*(f"HX{thread}" for thread in threads), *LEAVE_CONTOUR, OUTPUT_PASSIVE))

    async def list_lines(self, session: CommandSession, first: int, last: int) -> list[str]:
        """Return lines of the program by their numbers (LS, L7093), as far as it has them."""
        return [line.partition(" ")[2].rstrip() for line in await session.query_all(f"LS {first},{last}")]

    async def _is_probing(self, session: CommandSession) -> bool:
        """Return whether the program watches the input of a probe. A controller that was off meanwhile, with its
        program stored, does not have the variable."""
        try:
            (number,), _ = await session.read_numbers(PROBE_INPUT)
        except SmcCommandRefused:
            return False
        return bool(number)

    async def _require_replaceable(self, session: CommandSession, present: list[str]) -> None:
        thread_states, _ = await session.read_numbers(*(f"_HX{thread}" for thread in range(4)))
        more, _ = await session.read_numbers(*(f"_HX{thread}" for thread in range(4, THREADS)))
        threads = [str(thread) for thread, state in enumerate(thread_states + more) if state]
        if threads:
            raise ControllerFault(
                "other-program",
                f"another program runs in the controller (thread {', '.join(threads)})",
                "stop it with HX, and its #AUTO start with it, if this controller belongs to the fleet",
            )
        if present and not self._options.replace_program:
            raise ControllerFault(
                "other-program",
                f"the controller holds another program of {len(present)} lines, which may not be replaced",
                "save it, then set `replace_program: true` in the controller's options",
            )
