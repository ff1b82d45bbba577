"""The loading of a step: its program written, read back, and checked until it starts."""

from collections.abc import Mapping

from adapters.smc30.lowering import TARGET_REGISTER, Smc30Lowered
from adapters.smc30.session import ControllerBusy
from adapters.smc30.step import LoadedStep
from adapters.smc30.unitstate import SENTINEL, SENTINEL_REGISTER, Smc30State
from orchestrator.clock.base import Clock
from orchestrator.model.errors import Refusal


class ProgramLoader:
    """Load the programs of one controller."""

    def __init__(self, clock: Clock, unit: Smc30State) -> None:
        self._clock = clock
        self._unit = unit

    async def load_step(self, move: LoadedStep) -> Mapping[str, int]:
        """Load the program and read it back; a program that waits for a trigger line begins to wait. Return what took
        how long, ns. Raises `Refusal`.

        Behind a step that has just ended where this one begins, only the check before the commit, which is next, reads
        the position: a controller that executes something refuses the program."""
        lowered_step, unit = move.lowered, self._unit
        if not lowered_step.program:
            return {}
        if lowered_step.target is not None and not unit.enabled:
            raise Refusal(
                "not-enabled", f"axis {lowered_step.axis} is not enabled", f"enable {lowered_step.axis} first"
            )
        began_ns, stop_count = self._clock.now_ns(), unit.session.stops
        async with unit.loading:
            await unit.wait_for_stops()
            async with unit.exclusive_turn():
                if not (move.behind and self._begins_here(lowered_step)):
                    await self._require_start(lowered_step)
                loaded_ns = await self._load_program(move, stop_count)
        unit.session.require_no_stop(stop_count)
        return {"wire": loaded_ns - began_ns, "verify": self._clock.now_ns() - loaded_ns}

    async def _load_program(self, move: LoadedStep, since: int) -> int:
        """Load the program and read it back, and start its wait if it has one; return when it was loaded. Right behind
        a step with the same program, only the target is loaded."""
        lowered_step, unit = move.lowered, self._unit
        if not (move.behind and lowered_step.by_register and unit.program == lowered_step.program):
            await unit.load_program(lowered_step.program, since)
        if lowered_step.by_register and lowered_step.target is not None:
            await self._load_target(lowered_step.target)
        loaded_ns = self._clock.now_ns()
        if lowered_step.wait is not None or lowered_step.drive is not None:
            await self._require_passive(lowered_step)
        if lowered_step.wait is None:
            return loaded_ns
        # A start by the host is verified before the commit; this program runs from now on.
        await unit.require_not_restarted("armed", "arm it again; its axis must be homed before")
        move.running = True
        await unit.run_program(since, "step")
        if not (await unit.read_status()).busy:
            raise Refusal(
                "line-level",
                f"axis {lowered_step.axis} has not begun to wait for input {lowered_step.wait.name}",
                "is the trigger line already active?",
            )
        return loaded_ns

    async def verify_step(self, move: LoadedStep) -> None:
        """Check that the program is still loaded at the start of the plan, or still waits for its trigger line. Raises
        `Refusal`."""
        lowered_step, unit = move.lowered, self._unit
        if not lowered_step.program:
            return
        if lowered_step.wait is not None:
            if not (await unit.read_status()).busy:
                raise Refusal(
                    "not-armed",
                    f"axis {lowered_step.axis} no longer waits for input {lowered_step.wait.name}",
                    "arm it again; was the trigger line active, or was the controller stopped or switched off?",
                )
            return
        if move.behind and lowered_step.by_register and lowered_step.target is not None:
            # Where it stands is known from the end of the last step, unless it has lost its counter since.
            await self._require_target(lowered_step.target)
            return
        await self._require_start(lowered_step)
        try:
            is_loaded = unit.program == lowered_step.program and await unit.holds_sentinel()
        except ControllerBusy:
            is_loaded = False
        if not is_loaded:
            raise Refusal("not-loaded", f"{unit.session.name} has lost its program", "arm it again")

    async def _load_target(self, target: int) -> None:
        """Load the target of a program that takes it from a register, and verify it. Raises `Refusal`.

        The controller computes it from the sentinel: after a restart it would be another one, and its position
        unknown."""
        more = target - SENTINEL
        command = f"R{TARGET_REGISTER}=R{SENTINEL_REGISTER}{'-' if more < 0 else '+'}{abs(more)}"
        try:
            await self._unit.session.send_setting(command)
        except ControllerBusy:
            raise self._unit.moving_refusal() from None
        await self._require_target(target)

    async def _require_target(self, target: int) -> None:
        """Verify a target that was loaded, and that the controller has not been restarted since. Raises `Refusal`."""
        unit = self._unit
        try:
            held_target = await unit.read_register(TARGET_REGISTER)
        except ControllerBusy:
            raise unit.moving_refusal() from None
        if held_target != target:
            await unit.require_not_restarted("loaded", "home its axis, and arm it again")
            text = f"{unit.session.name} was given the target {target}, and reports {held_target}"
            raise Refusal("load-garbled", text, "arm it again; check the cable, and whether another client programs it")

    def _begins_here(self, lowered: Smc30Lowered) -> bool:
        """Whether a step that starts by the host begins where the axis stood at the end of the last one."""
        is_plain = lowered.wait is None and lowered.drive is None
        return is_plain and not self._unit.programming and self._unit.rest_counts == lowered.start_counts

    async def _require_start(self, lowered: Smc30Lowered) -> None:
        counts = await self._unit.require_ready()
        if lowered.target is not None and counts != lowered.start_counts:
            raise Refusal(
                "other-start",
                f"axis {lowered.axis} is at {counts} steps; the plan starts at {lowered.start_counts}",
                "plan again from the present position",
            )

    async def _require_passive(self, lowered: Smc30Lowered) -> None:
        """Check that the awaited or driven trigger line is not active yet."""
        try:
            inputs, outputs = await self._unit.read_points()
        except ControllerBusy:
            raise self._unit.moving_refusal() from None
        for kind, point, levels in (("input", lowered.wait, inputs), ("output", lowered.drive, outputs)):
            if point is not None and levels[point.number] == point.high:
                raise Refusal(
                    "line-level",
                    f"{kind} {point.name} ({point.number}) is already active",
                    "make the trigger line passive; see `active` in the fleet file",
                )
