"""The resident program in an SMC-2000: installed and listed line by line over a serial line."""

from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.resident import ResidentProgram
from adapters.yaskawa.smc2000 import program as smc2000_program
from adapters.yaskawa.smc2000.session import SerialCommandSession
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from orchestrator.model.errors import ControllerFault

THREADS = 4  # L3405
AROUND_LISTED = 6  # characters of a listed line besides its text: number, blank, CR LF
LISTING_CHARACTERS = 8000  # longest program; a controller may send its listing with a delay


class SerialResidentProgram(ResidentProgram):
    """The resident program of one controller of a serial line."""

    def __init__(self, options: YaskawaOptions, *, chained: bool) -> None:
        super().__init__(options, smc2000_program.STEP_THREADS)
        self._chained = chained

    async def install_lines(self, session: SerialCommandSession, program: tuple[str, ...]) -> None:
        """Install the program if the controller does not have it. Raises `ControllerFault`."""
        self.lines = program
        await self._unload_own_program(session)
        if not await self._holds_program(session, program):
            await self._require_no_other_program(session)
            session.log.info("installing the resident program", lines=len(program))
            try:
                await session.download_program(program)
            except SmcCommandRefused as refusal:
                raise ControllerFault(
                    "program-refused",
                    f"the controller does not accept its program: {refusal}",
                    "is its program memory locked (LC)?",
                ) from None
            if not await self._holds_program(session, program):
                raise ControllerFault(
                    "program-differs",
                    "the program read back is not the one that was sent",
                    "check the cable; the adapter keeps retrying",
                )

    async def _unload_own_program(self, session: SerialCommandSession) -> None:
        """Unload the adapter's own program: it may still wait for a start that will never be released. Its first line
        identifies it, long before all of it is read."""
        if any(smc2000_program.HEADING in line for line in await self._list_lines(session, 0, 0)):
            await self.unload(session)

    async def _holds_program(self, session: SerialCommandSession, wanted: tuple[str, ...]) -> bool:
        """Return whether `wanted` is the controller's program."""
        if not self._chained:
            return await self._list_program(session) == list(wanted)
        at = 0
        for part in smc2000_program.split_program(wanted):
            # The controller may send its listing with a delay.
            characters = sum(len(line) + AROUND_LISTED for line in part)
            if await self._list_lines(session, at, at + len(part) - 1, characters) != list(part):
                return False
            at += len(part)
        return not await self._list_lines(session, at, at)

    async def list_own_lines(self, session: SerialCommandSession, first: int, last: int) -> list[str]:
        """Return lines of the program by their numbers, as far as it has them."""
        characters = sum(len(line) + AROUND_LISTED for line in self.lines[first : last + 1])
        return await self._list_lines(session, first, last, characters)

    async def _list_lines(self, session: SerialCommandSession, first: int, last: int, characters: int = 0) -> list[str]:
        """Return lines of the program by their numbers (LS, L10135); none where it has none, or does not list them."""
        try:
            listing = await session.query_all(f"LS {first},{last}", characters)
        except SmcCommandRefused:
            return []
        return [line.partition(" ")[2].rstrip() for line in listing]

    async def _list_program(self, session: SerialCommandSession) -> list[str]:
        try:
            return [line.rstrip() for line in await session.query_all("UL", LISTING_CHARACTERS)]
        except SmcCommandRefused as refusal:
            raise ControllerFault(
                "program-refused", f"the controller does not list its program: {refusal}", "unlock it (LC password,0)"
            ) from None

    async def _require_no_other_program(self, session: SerialCommandSession) -> None:
        thread_states, _ = await session.read_numbers(*(f"_HX{thread}" for thread in range(THREADS)))
        threads = [str(thread) for thread, state in enumerate(thread_states) if state]
        if threads:
            raise ControllerFault(
                "other-program",
                f"another program runs in the controller (thread {', '.join(threads)})",
                "stop it with HX, and its #AUTO start with it, if this controller belongs to the fleet",
            )
        present = await self._list_program(session)
        if present and not self._options.replace_program:
            raise ControllerFault(
                "other-program",
                f"the controller holds another program of {len(present)} lines, which may not be replaced",
                "save it, then set `replace_program: true` in the controller's options",
            )
