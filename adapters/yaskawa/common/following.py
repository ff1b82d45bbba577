"""A move behind the present one: loaded into variables while that is executed, and begun after its end."""

from collections.abc import Mapping

from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.loaded import EVIDENCE_WAIT_NS, SETTLE_NS, TICKS_MAX, LoadedMove
from adapters.yaskawa.common.loads import YaskawaLowered
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import (
    BEGIN_VARIABLE,
    EDGE_THREAD,
    REGISTER_VARIABLES,
    at_once_label,
    following_label,
)
from adapters.yaskawa.common.watchdog import StepWatchdog
from orchestrator.clock.base import Clock, sleep_ns
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import LATE_REMEDY, ControllerFault, Refusal


class FollowingStart:
    """The following move of one controller, up to its start."""

    def __init__(self, device: SmcDevice, clock: Clock, options: YaskawaOptions) -> None:
        self._device = device
        self._clock = clock
        self._options = options
        self._watchdog = StepWatchdog(device, options)
        self.move: LoadedMove | None = None

    def require_move(self) -> LoadedMove:
        """Return the following move. Raises `Refusal` (code `not-armed`)."""
        if self.move is None:
            raise Refusal("not-armed", "no move is loaded behind the present one", "arm it first")
        return self.move

    @property
    def released_ticks(self) -> int:
        """The sample at which a released following move begins, which the watchdog must outlast; 0 without one."""
        return self.move.ticks if self.move is not None and self.move.released else 0

    async def load_move(
        self, present: LoadedMove, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping
    ) -> Mapping[str, int]:
        """Load the registers of the following move into variables, read them back, and start its program, which waits
        for the end of the present move. Raises `Refusal`."""
        load, began_ns = lowered.load, self._clock.now_ns()
        if not (load.fits_beside and present.lowered.load.fits_beside):
            raise Refusal("no-room", "the program holds one contour at a time", "")
        first_thread, second_thread = self._device.STEP_THREADS
        if second_thread == EDGE_THREAD and (present.lowered.drives or present.lowered.switches):
            raise Refusal("no-room", "the program still drives an output of the present step", "")
        first, _ = self._options.begin_ticks(mapping.tick_ns, interleaved=True)
        ticks = round(mapping.to_ticks(t0_ns)) - first
        if ticks > TICKS_MAX:
            raise Refusal("counter-full", "the sample counter overflows before the start", "restart the controller")
        if not lowered.at_once and ticks - present.end_ticks < self.gap_ticks(present):
            raise Refusal("late", "the step begins too soon after the one before it", LATE_REMEDY)
        await self._wait_until_taken(present)
        positions = await self._end_positions(present)
        for move in lowered.moves:
            if positions[move.index] != move.start:
                text = f"axis {move.axis} ends at {positions[move.index]} counts; the plan starts at {move.start}"
                raise Refusal("other-start", text, "plan again from the present position")
        is_quick = lowered.at_once and _has_registers(present, lowered)
        wanted_values = self._list_values(ticks, positions, load.registers, is_quick=is_quick)
        following = LoadedMove(
            lowered,
            ticks,
            t0_ns,
            mapping,
            {},
            thread=first_thread + second_thread - present.thread,
            follows=True,
            taken=False,
        )
        self.move = following
        held_values = await self._device.session.set_and_read(
            [f"{name}={value}" for name, value in wanted_values.items()],
            list(wanted_values),
            f"XQ {_entry_label(lowered, is_quick=is_quick)},{following.thread}",
        )
        for (name, value), held_value in zip(wanted_values.items(), held_values, strict=True):
            if held_value != value and name != "XFARM":
                raise Refusal("read-back", f"{name} reads back as {held_value:.0f}, not {value}", "try again")
        return {"wire": self._clock.now_ns() - began_ns}

    def _list_values(
        self, ticks: int, positions: list[int], registers: Mapping[str, Mapping[int, int]], *, is_quick: bool
    ) -> dict[str, int]:
        """The variables of the following move. is_quick: only targets are loaded into registers."""
        wanted_values = {"XFT": ticks, "XFGO": 0, "XFARM": 0, "XFL": 0, "XFA": 0}
        wanted_values |= {f"{BEGIN_VARIABLE}{index + 1}": positions[index] for index in self._device.program_axes}
        for command, values in registers.items():
            if command == "PA" or not is_quick:
                wanted_values |= {f"{REGISTER_VARIABLES[command]}{index + 1}": values[index] for index in values}
        return wanted_values

    def gap_ticks(self, move: LoadedMove) -> int:
        """Return how many samples pass between the end of `move` and the begin of one behind it, at the least."""
        axes, moving_count = len(self._device.program_axes), len(move.lowered.moving_axes)
        return self._device.gate.gap_ticks(moving_count, axes, move.mapping.tick_ns)

    async def _wait_until_taken(self, present: LoadedMove) -> None:
        """Wait until the program no longer uses the variables of the following move for the present one."""
        until_ns = present.t0_ns + EVIDENCE_WAIT_NS
        while not present.taken:
            (ticks,), _ = await self._device.session.read_numbers("XT0")
            present.taken = int(ticks) == present.ticks
            if not present.taken:
                if self._clock.now_ns() > until_ns:
                    raise Refusal("not-begun", "the present step has not begun", "")
                await sleep_ns(self._clock, SETTLE_NS)

    async def _end_positions(self, present: LoadedMove) -> list[int]:
        """Return where each axis is when the present move has ended, counts."""
        record = await self._device.read_record()
        positions = [axis.commanded for axis in record.axes]
        for move in present.lowered.moves:
            positions[move.index] = move.end
        return positions

    async def verify_move(self, following: LoadedMove) -> None:
        """Check that its program still waits for the end of the move before. Raises `Refusal`."""
        (armed_ticks, is_running, is_missed), _ = await self._device.session.read_numbers(
            "XFARM", f"_HX{following.thread}", "XFL"
        )
        if is_missed or self._clock.now_ns() > following.t0_ns:
            raise Refusal("late", "the step before has not ended in time", LATE_REMEDY)
        if not is_running or int(armed_ticks) != following.ticks:
            raise Refusal("not-armed", "the controller does not wait for this start", "arm it again")

    async def release_move(self, following: LoadedMove, advance_ns: int) -> None:
        """Let its program begin it at its sample if the move before has ended as planned. Raises `Refusal`."""
        session, commands = self._device.session, list[str]()
        if advance_ns:
            following.ticks -= round(advance_ns / following.mapping.tick_ns)
            following.t0_ns -= advance_ns
            commands = [f"XFT={following.ticks}", f"XFARM={following.ticks}"]
        is_near = following.mapping.to_ticks(self._clock.now_ns()) > following.ticks - self._device.gate.follow_before
        if is_near and not following.lowered.at_once:
            raise Refusal("late", "it is too late to release the start", LATE_REMEDY)
        following.released = True  # before that, so that no query of the present move sets an earlier deadline
        await session.send_settings([*commands, self._watchdog.extension_command(following.ticks), "XFGO=1"])
        (ticks, is_released, is_missed, is_running, begun_ticks), _ = await session.read_numbers(
            "XFT", "XFGO", "XFL", f"_HX{following.thread}", "XT0"
        )
        if is_missed or not (is_running or int(begun_ticks) == following.ticks):
            raise Refusal("late", "the controller no longer waits for this start", LATE_REMEDY)
        if int(ticks) != following.ticks or not is_released:
            raise Refusal("read-back", f"XFT reads back as {ticks:.0f}, not {following.ticks}", "try again")

    async def unload_move(self) -> None:
        """Unload the following move; the present one continues."""
        following, self.move = self.move, None
        if following is not None:
            await self._device.session.send_settings(("XFGO=0", f"HX{following.thread}"))
            (is_running,), _ = await self._device.session.read_numbers(f"_HX{following.thread}")
            if is_running:
                raise ControllerFault("not-halted", "the waiting program does not halt", "reset the controller")


def _has_registers(present: LoadedMove, lowered: YaskawaLowered) -> bool:
    """Whether the controller has the speeds and ramps of the axes of `lowered` from the present move."""
    held_values = present.lowered.load.register_values
    return all(
        held_values.get(command, {}).get(index) == value
        for command, values in lowered.load.register_values.items()
        for index, value in values.items()
    )


def _entry_label(lowered: YaskawaLowered, *, is_quick: bool) -> str:
    return at_once_label(lowered.mask, quick=is_quick) if lowered.at_once else following_label(lowered.mask)
