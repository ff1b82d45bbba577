"""Checks of whole steps: connecting, motors, references, lowering, starts and ends with their evidence."""

from collections.abc import Mapping
from typing import get_args

from adapters.contract import HostInterval, MoveOutcome
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.conformance.checks import ContractCheck, require_line_start
from orchestrator.conformance.findings import NotApplicable, require, require_error
from orchestrator.conformance.worlds import World, motions_by_axis, require_evidence
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions, TriggerDrive, TriggerWait, sum_terms
from orchestrator.model.profile import Profile
from orchestrator.model.state import StartClass
from sim.core.controller import CommandedMotion

HOLD_NS = 50 * NS_PER_MS


async def check_connection(world: World) -> None:
    """Connect, compare, read; and again."""
    identity = await world.driver.connect()
    require(identity.model, "the identity has no model")
    await world.driver.configure()
    reading = await world.driver.poll()
    require(list(reading.axes) == world.axes, f"the reading has the axes {list(reading.axes)}, not {world.axes}")
    require(not reading.restarted, "a controller that was connected to for the first time is reported as restarted")
    capabilities = world.driver.capabilities
    require(capabilities.start_classes, "no start class is declared")
    require(2 in capabilities.orders, "trapezoids (order 2) are not declared")
    costs = capabilities.costs
    require(min(costs.arm_ns, costs.disarm_ns, costs.stop_ns) > 0, f"a declared cost is not positive: {costs}")
    # Reached again, while nothing is wrong, it is the same.
    await world.leave()
    second_identity = await world.driver.connect()
    require(
        second_identity == identity, f"connected again, it identifies itself as {second_identity}, before as {identity}"
    )


async def check_motors_and_homing(world: World) -> None:
    """Switch motors, and home all axes."""
    await world.ready()
    await world.driver.set_enabled(world.axes, on=False)
    axes = (await world.driver.poll()).axes.values()
    require(not any(axis.enabled for axis in axes), "an axis that was disabled is reported as enabled")
    refusal = await require_error(
        world.driver.home_axes(world.axes, lambda _: None), "homing of disabled axes", Refusal
    )
    require("enable" in str(refusal), f"the refusal of homing does not say that the axis is not enabled: {refusal}")
    require(not world.motions, "a disabled axis has moved")
    await world.driver.set_enabled(world.axes, on=True)
    axes = (await world.driver.poll()).axes.values()
    require(all(axis.enabled for axis in axes), "an axis that was enabled is reported as disabled")
    references: list[str] = []
    failures = await world.driver.home_axes(world.axes, references.append)
    require(not failures, f"homing failed: {failures}")
    require(sorted(references) == sorted(world.axes), f"references found: {references}, expected {world.axes}")
    require(world.at_rest, "an axis moves after homing has returned")
    counts = {name: axis.commanded_counts for name, axis in (await world.driver.poll()).axes.items()}
    require(not any(counts.values()), f"after homing the positions are {counts}, not 0")


async def check_steps(world: World) -> None:
    """Steps to and fro, with evidence and bounds."""
    await world.ready(60)
    for factor in (1.0, -0.4, 2.0):
        motion_count = len(world.motions)
        lowered_step, start_spans, outcome, t0_ns, profiles = await world.move(world.targets(factor))
        motions = _require_done(world, motion_count, start_spans, outcome)
        earliest_ns, latest_ns = lowered_step.window_ns
        for axis, motion in motions.items():
            after_ns = motion.start_ns - t0_ns
            require(
                earliest_ns <= after_ns <= latest_ns or world.was_line_late(motion.start_ns),
                f"{axis} started {after_ns} ns after T0, declared were {earliest_ns} to {latest_ns} ns",
            )
            _require_end(axis, motion.end_counts, profiles[axis])
        positions = {axis: reading.commanded_counts for axis, reading in (await world.driver.poll()).axes.items()}
        targets = {axis: profile.end_counts for axis, profile in profiles.items()}
        require(positions == targets, f"positions read after the step: {positions}, expected {targets}")


def _require_done(
    world: World, before: int, started: Mapping[str, HostInterval], outcome: MoveOutcome
) -> Mapping[str, CommandedMotion]:
    """Return the motions of a step by axis, which must be done, with evidence that contains the truth. before: number
    of motions before it."""
    require(outcome.state == "done", f"a step ended as {outcome.state}: {outcome.reason}")
    motions = motions_by_axis(world, before)
    require_evidence(started, {axis: motion.start_ns for axis, motion in motions.items()}, "start")
    require_evidence(outcome.ended, {axis: motion.end_ns for axis, motion in motions.items()}, "end")
    return motions


def _require_end(axis: str, end_counts: float | None, profile: Profile) -> None:
    require(end_counts == profile.end_counts, f"{axis} went to {end_counts}, planned was {profile.end_counts}")


async def check_sooner_start(world: World) -> None:
    """Steps that start sooner than they were armed for."""
    await world.ready(60)
    for factor in (1.0, -0.4):
        motion_count = len(world.motions)
        profiles = await world.plan(world.targets(factor))
        lowered_step, armed_for_ns = await world.arm(profiles)
        if not lowered_step.can_advance:
            raise NotApplicable("this make begins when it was armed to")
        tick_ns = lowered_step.tick_ns or 1.0
        sooner_ns = round(100 * NS_PER_MS // tick_ns * tick_ns)
        await world.driver.slots.present.verify()
        await world.driver.slots.present.release(0, sooner_ns)
        start_spans, outcome = (
            await world.driver.slots.present.wait_for_start(),
            await world.driver.slots.present.wait_for_end(),
        )
        motions = _require_done(world, motion_count, start_spans, outcome)
        earliest_ns, latest_ns = lowered_step.window_ns
        for axis, motion in motions.items():
            after_ns = motion.start_ns - (armed_for_ns - sooner_ns)
            require(
                earliest_ns - 1 <= after_ns <= latest_ns + 1,
                f"{axis} started {after_ns} ns after the earlier T0, declared were {earliest_ns} to {latest_ns} ns",
            )
            _require_end(axis, motion.end_counts, profiles[axis])


async def check_lowering(world: World) -> None:
    """Lower twice, and with every start class."""
    await world.ready()
    profiles, mapping = await world.plan(world.targets()), world.driver.clock_mapping()
    first = world.driver.lower_profiles(profiles, StartOptions(), mapping)
    second = world.driver.lower_profiles(profiles, StartOptions(), mapping)
    require(first == second, "the same profiles are lowered in two ways")
    require(first.commands, "the lowered step shows no commands")
    for by in sorted(set(get_args(StartClass)) - {"line"}):  # which needs a wire
        start = StartOptions(start_class=by)
        if by in world.driver.capabilities.start_classes:
            start_class = world.driver.lower_profiles(profiles, start, mapping).start_class
            require(start_class == by, f"a start by {by} is lowered as a start by {start_class}")
            continue
        try:
            world.driver.lower_profiles(profiles, start, mapping)
        except Refusal as error:
            require(error.code == "start-class", f"a start by {by} is refused with code {error.code}, not start-class")
            require(error.remedy, f"the refusal of a start by {by} has no remedy")
        else:
            require(False, f"a start by {by}, which is not declared, is lowered")  # noqa: FBT003 - a condition
    require(not world.motions, "lowering has moved an axis")


async def check_line_start(world: World) -> None:
    """Steps that wait for a trigger line."""
    world.line(active=False)
    await world.ready(60)
    require_line_start(world)
    window_ns = NS_PER_MS
    options = StartOptions(wait=TriggerWait(input="line", earliest_ns=-window_ns, latest_ns=window_ns))
    for factor in (1.0, -0.4):
        motion_count = len(world.motions)
        profiles = await world.plan(world.targets(factor))
        lowered_step, t0_ns = await world.arm(profiles, options)
        require(
            lowered_step.start_class == "line", f"a start by line is lowered as a start by {lowered_step.start_class}"
        )
        await world.driver.slots.present.verify()
        await world.driver.slots.present.release()
        require(world.at_rest, "the step started before its line")
        edge_ns = t0_ns + world.draw.randrange(-window_ns, window_ns)
        await world.until(edge_ns)
        require(world.at_rest, "the step started before its line")
        world.line(active=True)
        start_spans = await world.driver.slots.present.wait_for_start()
        outcome = await world.driver.slots.present.wait_for_end()
        motions = _require_done(world, motion_count, start_spans, outcome)
        earliest_ns, latest_ns = sum_terms(term for term in lowered_step.terms if term.name != "line")
        for axis, motion in motions.items():
            after_ns = motion.start_ns - edge_ns
            require(
                earliest_ns <= after_ns <= latest_ns,
                f"{axis} started {after_ns} ns after its line, declared were {earliest_ns} to {latest_ns} ns",
            )
        world.line(active=False)


async def check_active_line(world: World) -> None:
    """A line that is active already, and disarmed moves that must not wait for it."""
    world.line(active=False)
    await world.ready()
    require_line_start(world)
    wait = TriggerWait(input="line", earliest_ns=0, latest_ns=NS_PER_MS)
    options = StartOptions(wait=wait)
    profiles = await world.plan(world.targets())
    world.line(active=True)
    error = await require_error(world.arm(profiles, options), "arming with an active line", Refusal)
    require(error.code == "line-level" and error.remedy, f"the refusal has code {error.code}, remedy {error.remedy!r}")
    await world.driver.slots.unload()
    world.line(active=False)
    for is_released in (False, True):
        await sleep_ns(world.clock, 2 * NS_PER_MS)  # the input's optocoupler
        await world.arm(profiles, options)
        await world.driver.slots.present.verify()
        if is_released:
            await world.driver.slots.present.release()
            await world.driver.stop(abort=False)
        await world.driver.slots.unload()
        world.line(active=True)
        await sleep_ns(world.clock, NS_PER_S)
        require(not world.motions, "a disarmed move was started by its line")
        world.line(active=False)
    other_options = StartOptions(wait=wait.model_copy(update={"input": "other"}))
    try:
        world.driver.lower_profiles(profiles, other_options, None)
    except Refusal:
        return
    require(False, "a line that the fleet file does not name is accepted")  # noqa: FBT003 - a condition


async def check_driven_line(world: World) -> None:
    """Steps that drive an output at T0."""
    if "line" not in world.hit.config.outputs:
        raise NotApplicable("this make has no outputs, or its example names none")
    world.line(active=False)
    await world.ready(60)
    options = StartOptions(drive=TriggerDrive(output="line", active_ns=HOLD_NS))
    changes: list[tuple[int, bool]] = []
    for unit in world.units:
        unit.controller.on_output(lambda number, level: changes.append((world.clock.now_ns(), level)))
    for moves in (False, True):
        changes.clear()
        motion_count = len(world.motions)
        profiles = await world.plan(world.targets()) if moves else {}
        lowered_step, t0_ns = await world.arm(profiles, options)
        require(lowered_step.edge, "the lowered step declares no interval of the edge")
        await world.driver.slots.present.verify()
        await world.driver.slots.present.release()
        require(not changes, "the output changed before T0")
        start_spans = await world.driver.slots.present.wait_for_start()
        require(start_spans.keys() == profiles.keys(), f"started axes: {list(start_spans)}, expected {list(profiles)}")
        outcome = await world.driver.slots.present.wait_for_end()
        require(outcome.state == "done", f"a step ended as {outcome.state}: {outcome.reason}")
        await world.until(t0_ns + 4 * HOLD_NS)
        require([level for _, level in changes] == [True, False], f"the output changed so: {changes}")
        (edge_ns, _), (released_ns, _) = changes
        earliest_ns, latest_ns = lowered_step.edge_window_ns
        require(
            earliest_ns <= edge_ns - t0_ns <= latest_ns,
            f"the edge came {edge_ns - t0_ns} ns after T0, declared were {earliest_ns} to {latest_ns} ns",
        )
        require(released_ns - edge_ns >= HOLD_NS * 0.99, f"the output was active for {released_ns - edge_ns} ns only")
        new_count = len(world.motions) - motion_count
        require(new_count == len(profiles), f"{new_count} axes moved, expected {len(profiles)}")
    changes.clear()
    await world.arm({}, options)
    await world.driver.slots.unload()
    _, t0_ns = await world.arm({}, options)
    await world.driver.slots.present.verify()
    await world.driver.slots.present.release()
    await world.driver.stop(abort=False)
    await world.until(t0_ns + NS_PER_S)
    require(not any(level for _, level in changes), "an output became active after a disarm or a stop")


async def check_polls_in_motion(world: World) -> None:
    """Polls during a step."""
    await world.ready()
    profiles = await world.plan(world.targets(3))
    _, t0_ns = await world.arm(profiles)
    await world.driver.slots.present.verify()
    await world.driver.slots.present.release()

    async def poll() -> None:
        await world.until(t0_ns + NS_PER_MS)  # nothing polls a member just before T0
        while True:
            await world.poll(1)

    polling = world.start_task(poll())
    start_spans = await world.driver.slots.present.wait_for_start()
    outcome = await world.driver.slots.present.wait_for_end()
    polling.cancel()
    seldom = {name: times for name, times in world.polled_beside.items() if times <= 20}
    require(not seldom, f"controllers on the same line were hardly polled: {seldom}")
    _require_done(world, 0, start_spans, outcome)


STEP_CHECKS: tuple[ContractCheck, ...] = (
    ContractCheck("connected, identified, compared and read", check_connection),
    ContractCheck("motors are switched and axes homed", check_motors_and_homing),
    *(
        ContractCheck(
            "a step does what was lowered, and its evidence contains the truth",
            check_steps,
            f"seed {seed}, crystal {ppm:+g} ppm",
            seed,
            ppm,
            is_long=seed > 1,
        )
        for seed, ppm in ((0, -100.0), (1, 100.0), (2, 0.0), (3, 100.0))
    ),
    *(
        ContractCheck(
            "a step can start sooner than it was armed for", check_sooner_start, f"crystal {ppm:+g} ppm", 0, ppm
        )
        for ppm in (-100.0, 0.0, 100.0)
    ),
    ContractCheck("lowering is pure and refuses what it cannot do", check_lowering),
    *(
        ContractCheck(
            "a move waits for its line, and its evidence contains the truth", check_line_start, f"seed {seed}", seed
        )
        for seed in range(3)
    ),
    ContractCheck("an active line is refused, and a disarmed move does not wait for it", check_active_line),
    ContractCheck("a line is driven at its instant and released", check_driven_line),
    ContractCheck("polls during a step disturb nothing", check_polls_in_motion),
)
