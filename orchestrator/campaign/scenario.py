"""One seed of the fault campaign: a fleet at work, with faults that are injected and repaired, checked against the
simulators' ground truth.

A seed prepares a fleet and then runs phases. In each phase, jobs are submitted that run in parallel or one after the
other, sometimes an axis is jogged manually, and one fault is injected at a stage of a step. It is repaired, and the
remaining jobs run to their end. The true motions are checked against the invariants of the design (section 7).
"""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from contextvars import Context
from dataclasses import dataclass, field, replace
from random import Random
from typing import NamedTuple

from orchestrator.bus.base import Sample
from orchestrator.campaign.faults import FAULTS, Breaker
from orchestrator.campaign.fleets import WITH_PERMIT, fleet_of
from orchestrator.campaign.invariants import Act, Jog, Judge
from orchestrator.campaign.jobs import MOST_S, PACE, orders_of, preparation, trial
from orchestrator.campaign.recorder import STAGES, Asked, Stage, Witness
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import FINISHED_STATES
from orchestrator.model.state import ControllerState
from orchestrator.runtime.virtual import VirtualFleet

SETTLE_NS = 2 * NS_PER_S  # from the fault to its repair: by then it is detected everywhere
REACH_NS = 20 * NS_PER_S  # for the stage to be reached
TRY_S = 10.0  # for a job that must be refused
READY_S = 25.0  # for a fleet to become ready after the repair
END_NS = 50 * NS_PER_S  # for the remaining jobs to end
LOOK_NS = 200 * NS_PER_MS
RESTS = 150  # polls for controllers at rest, 7 ms apart
# a pp-electronic SMC with an installed reference verifies its position, and does not move
_VOUCHED_NS = 250 * NS_PER_MS
HOMES_SHARE = 0.4  # of the expected homing time: within it nearly all axes are still homing
HANDS = 0.3  # chance of a jog during the phase
RENEWED_NS = 60 * NS_PER_MS
RENEWALS = 8  # of a jog, and of one that a fault shall interrupt
RENEWALS_OF_STAGE = 32
_JOG_NS = 600 * NS_PER_MS  # from the begin of a jog to its fault, at most

ALONE: tuple[Stage, ...] = ("jog", "home")  # a fault of the fleet affects only one member in these stages

# Time from the stage's first request to the member to the fault: earliest and latest.
_WITHIN: dict[str, tuple[int, int]] = {
    "propose": (0, 500 * NS_PER_US),
    "commit": (0, NS_PER_MS),
    "go": (0, 500 * NS_PER_US),
}
_FIRE_NS = 60 * NS_PER_MS  # around T0
_MOTION_NS = (150 * NS_PER_MS, 1500 * NS_PER_MS)  # after T0


class Cell(NamedTuple):
    """A fault to inject: the stage of a step, the fault, and the make of the member that it affects."""

    stage: Stage
    fault: str
    make: str


@dataclass(slots=True)
class Story:
    """The events of one seed, which took fleet_s of virtual time.

    hit: injected faults, by the stage that their step had reached.
    befallen: the same for each affected make.
    events: a summary.
    lines: the complete log.
    """

    seed: int
    cells: tuple[Cell, ...]
    fleet: Fleet
    hit: list[Cell] = field(default_factory=list[Cell])
    befallen: list[Cell] = field(default_factory=list[Cell])
    jobs: int = 0
    events: list[str] = field(default_factory=list[str])
    lines: list[str] = field(default_factory=list[str])
    violations: list[str] = field(default_factory=list[str])
    fleet_s: float = 0.0

    def tell(self) -> str:
        """Return a summary of the run with its violations."""
        controllers = ", ".join(f"{name} ({config.adapter})" for name, config in self.fleet.controllers.items())
        return "\n".join([f"seed {self.seed}: {controllers}", *self.events, *self.violations])


def play(seed: int, cells: Sequence[Cell]) -> Story:
    """Run one seed: a phase for each of `cells`. The run is deterministic."""
    makes = [cell.make for cell in cells]
    if any(cell.fault == "permit-lost" for cell in cells):
        makes.append(WITH_PERMIT)
    story = Story(seed, tuple(cells), fleet_of(seed, makes))

    async def main(clock: VirtualClock) -> None:
        play = _Play(story, clock)
        try:
            await play.run()
        finally:
            story.lines = play.virtual.lines
            story.violations = play.judge.violations
            story.fleet_s = clock.now_ns() / NS_PER_S

    try:
        run_virtual(main)
    except Exception as error:
        # An error in one of thousands of seeds must not discard the results of the others.
        story.violations.append(f"the seed did not run to its end: {error!r}")
    return story


class _Play:
    """The fleet of one seed."""

    def __init__(self, story: Story, clock: VirtualClock) -> None:
        self._story = story
        self._clock = clock
        self._draw = Random(story.seed)
        self._target: tuple[Act, Cell, asyncio.Future[tuple[str, int]]] | None = None
        self._reached: dict[tuple[tuple[str, int], str], dict[str, int]] = {}
        self._epochs: dict[str, int] = {}
        self._jogging = False
        self.witness = Witness(clock, self._heard)
        self.virtual = VirtualFleet(story.fleet, clock, story.seed, beside=self.witness.beside)
        self.judge = Judge(self.virtual, self.witness)
        self._breaker = Breaker(self.virtual, clock, self._draw)

    async def run(self) -> None:
        """Prepare the fleet, and run one phase after the other."""
        await self.virtual.start()
        client = self.virtual.client()
        await self.virtual.client("watcher").bus.subscribe(self.virtual.keys.state(), self._hear_state)
        looking = asyncio.get_running_loop().create_task(self._look())
        axes = list(self._story.fleet.controllers)
        if await self._prepared(client, axes, axes):
            for number, cell in enumerate(self._story.cells):
                await self._play(client, cell)
                if number + 1 < len(self._story.cells) and not await self._repaired(client):
                    break
        looking.cancel()
        self._judge_reigns()

    def _tell(self, text: str) -> None:
        self._story.events.append(f"{self._clock.now_ns() / NS_PER_S:8.3f} s  {text}")

    async def _look(self) -> None:
        while True:
            self.judge.look(self._clock.now_ns())
            await sleep_ns(self._clock, LOOK_NS)

    async def _prepared(self, client: Tutti, axes: list[str], homing: list[str]) -> bool:
        self._story.jobs += 1
        report = await client.wait_for_job(await client.submit(preparation(axes, homing)))
        if report.state != "done":
            self.judge.violate("3", f"the preparation of {axes} is {report.state}: {report.reason}")
        self.judge.judge_places(await client.status(1.0))
        return report.state == "done"

    # A phase

    async def _play(self, client: Tutti, cell: Cell) -> None:
        fleet, fault = self._story.fleet, FAULTS[cell.fault]
        member = self._draw.choice([n for n, config in fleet.controllers.items() if config.adapter == cell.make])
        before = {name: len(unit.commanded_motions) for name, unit in self.virtual.controllers.items()}
        act = Act(fault, member, self._breaker.touched(fault, member), before)
        reached: asyncio.Future[tuple[str, int]] = asyncio.get_running_loop().create_future()
        self._target = act, cell, reached
        keys: dict[str, str] = {}
        by_hand: asyncio.Task[None] | None = None
        if cell.stage == "jog":
            by_hand = asyncio.get_running_loop().create_task(self._jog(act, member, RENEWALS_OF_STAGE, reached))
            while not self._jogging and not by_hand.done():
                await sleep_ns(self._clock, NS_PER_MS)
        for order in orders_of(fleet, member, cell.stage == "home", self._where(), self._draw):
            keys[order.job.name] = key = self.virtual.new_id()
            act.jobs[await client.submit(order.job, key, order.terms)] = order
            self._tell(f"{order.job.name} of {', '.join(order.controllers)}")
        self._story.jobs += len(act.jobs)
        if by_hand is None and self._draw.random() < HANDS:
            by_hand = asyncio.get_running_loop().create_task(self._jog_free(act))
        step = await self._wait_for(reached, act)
        self._target = None
        if step is not None:
            await self._break(act, cell, step)
        await self._ends(client, act)
        if by_hand is not None:
            await by_hand
        await self._again_the_same(client, act, keys)
        await self._see_who_rests(act)
        for job_id, order in act.jobs.items():
            row = self.virtual.journal.load_record(job_id)
            self._tell(
                f"{order.job.name} is {row.state}: {row.reason}"
                if row
                else f"{order.job.name} is missing from the journal"
            )
        self.judge.judge(act)
        self.judge.judge_places(await client.status(1.0))

    def _where(self) -> dict[str, float]:
        """Return the position of each axis, in its unit."""
        return {
            f"{name}.{axis}": each.to_unit(self.virtual.controllers[name].position(each.motors[0]))
            for name, config in self._story.fleet.controllers.items()
            for axis, each in config.axes.items()
        }

    async def _wait_for(self, reached: "asyncio.Future[tuple[str, int]]", act: Act) -> tuple[str, int] | None:
        """Wait until the step reaches the stage of the fault; return None when all jobs end before that."""
        until_ns = self._clock.now_ns() + REACH_NS
        while not reached.done() and self._clock.now_ns() < until_ns and not self._ended(act):
            with suppress(TimeoutError):
                async with asyncio.timeout(0.5):
                    await asyncio.shield(reached)
        return reached.result() if reached.done() else None

    async def _break(self, act: Act, cell: Cell, step: tuple[str, int]) -> None:
        stage = self._stage_of(step, act.member) if cell.stage != "jog" else "jog" if self._jogging else None
        if stage is None:
            self._tell(f"too late for {cell.fault}")
            return
        now_ns = act.broken_ns = self._clock.now_ns()
        hit = cell._replace(stage=stage)
        all_of_step = act.fault.reach == "fleet" and stage not in ALONE
        together = act.jobs[step[0]].controllers if all_of_step else [act.member]
        makes = dict.fromkeys(self._story.fleet.controllers[name].adapter for name in together)
        self._story.hit.append(hit)
        self._story.befallen += [hit._replace(make=make) for make in makes]
        self._tell(f"{cell.fault} of {act.member} at {stage}")
        await self._breaker.strike(act.fault, act.member)
        await sleep_ns(self._clock, max(0, now_ns + SETTLE_NS - self._clock.now_ns()))
        await self._judge_latches(cell.fault)
        if cell.fault == "host-other-file":
            await self._try(act)
        act.mended_ns = self._clock.now_ns()
        await self._breaker.mend()
        self._tell("mended")

    async def _try(self, act: Act) -> None:
        """Submit a job that homes and moves a member whose host has another fleet file than the coordinator."""
        person = self.virtual.client("ben")
        order = trial(self._story.fleet, act.member)
        job_id = await person.submit(order.job, terms=order.terms)
        act.jobs[job_id] = order
        self._tell(f"job submitted for {act.member} with another fleet file")
        with suppress(TimeoutError):
            async with asyncio.timeout(TRY_S):
                await person.wait_for_job(job_id)
        await person.close()

    async def _ends(self, client: Tutti, act: Act) -> None:
        """Wait until the fleet is ready, then until all jobs end."""
        await self._ready(client)
        with suppress(Refusal):
            await client.release_jobs()
        until_ns = self._clock.now_ns() + END_NS
        while not self._ended(act) and self._clock.now_ns() < until_ns:
            await sleep_ns(self._clock, LOOK_NS)
        await sleep_ns(self._clock, NS_PER_S)

    def _ended(self, act: Act) -> bool:
        rows = [self.virtual.journal.load_record(job_id) for job_id in act.jobs]
        return all(row is None or row.state in FINISHED_STATES for row in rows)

    async def _ready(self, client: Tutti) -> None:
        """Wait until all controllers are adopted by the current leader and without a fault; reset latched e-stops."""
        fleet = self._story.fleet
        states: dict[str, ControllerState] = {}
        for _ in range(round(READY_S / 0.5)):
            states = await client.status(1.0)
            reigning = self.virtual.coordinators[self._breaker.reigning][1].leadership.epoch
            troubled = [
                name
                for name in fleet.controllers
                if name not in states or states[name].faults or states[name].mode == "offline"
            ]
            latched = [name for name, state in states.items() if state.estop is not None]
            strange = [name for name, state in states.items() if not reigning or state.epoch != reigning]
            if not troubled and not latched and not strange and len(states) == len(fleet.controllers):
                return
            if latched or troubled:
                await client.reset()
            await sleep_ns(self._clock, 500 * NS_PER_MS)
        shown = {
            name: (state.mode, state.epoch, [each.text for each in state.faults]) for name, state in states.items()
        }
        self.judge.violate("3", f"not ready {READY_S} s after the repair: {shown}")

    async def _repaired(self, client: Tutti) -> bool:
        """Enable and home the axes that the fault has left disabled or unreferenced."""
        # The fault may have been detected only after its repair.
        await self._ready(client)
        states = await client.status()
        axes = [(f"{name}.{axis}", each) for name, state in states.items() for axis, each in state.axes.items()]
        off = [name for name, each in axes if not each.enabled]
        lost = [name for name, each in axes if not each.referenced]
        if not off and not lost:
            return True
        self._tell(f"homing {', '.join(lost)}" if lost else f"enabling {', '.join(off)}")
        return await self._prepared(client, sorted({*off, *lost}), lost)

    async def _see_who_rests(self, act: Act) -> None:
        """Record the controllers at rest. A controller that decodes a poll at this moment is not at rest for a
        while: check repeatedly."""
        for _ in range(RESTS):
            act.resting |= {name for name, each in self.virtual.controllers.items() if each.at_rest()}
            if len(act.resting) == len(self.virtual.controllers):
                return
            await sleep_ns(self._clock, 7 * NS_PER_MS)

    async def _again_the_same(self, client: Tutti, act: Act, keys: dict[str, str]) -> None:
        """Check invariant 6: a client that repeats a request after a lost reply gets the same job."""
        job_id, order = next(iter(act.jobs.items()))
        try:
            again = await client.submit(order.job, keys[order.job.name], order.terms)
        except Refusal as error:
            self.judge.violate("9", f"a coordinator that cannot accept jobs answers for one: {error.text}")
            return
        if again != job_id:
            self.judge.violate("6", f"job {order.job.name} was accepted twice: {job_id} and {again}")

    async def _jog_free(self, act: Act) -> None:
        """Jog an axis that no job uses for a while."""
        busy = {name for order in act.jobs.values() for name in order.controllers}
        free = [name for name in self._story.fleet.controllers if name not in busy] or [act.member]
        await self._jog(act, self._draw.choice(free), RENEWALS)

    async def _jog(
        self, act: Act, name: str, renewals: int, reached: "asyncio.Future[tuple[str, int]] | None" = None
    ) -> None:
        """Jog an axis, and end without a stop command. reached: the future that triggers the fault."""
        axis_name, axis = next(iter(self._story.fleet.controllers[name].axes.items()))
        label = f"{name}.{axis_name}"
        way = -1 if self._where()[label] > axis.limits.velocity * PACE * MOST_S / 2 else 1
        person = self.virtual.client("hand")
        with suppress(Refusal):
            async with person.manual_control([label]) as hand:
                begun_ns = self._clock.now_ns()
                act.jogs.append(Jog(name, axis.motors[0], begun_ns, begun_ns))
                await hand.jog({label: way * axis.limits.velocity * PACE / 2})
                if reached is not None:
                    self._jogging = True
                    at_ns = self._clock.now_ns() + self._draw.randrange(_JOG_NS)
                    self._clock.call_at_ns(at_ns, lambda: reached.set_result(("", 0)), context=Context())
                with suppress(Refusal):
                    for _ in range(renewals):
                        await sleep_ns(self._clock, RENEWED_NS)
                        act.jogs[-1] = replace(act.jogs[-1], renewed_ns=self._clock.now_ns())
                        await hand.renew_jog()
                    await sleep_ns(self._clock, NS_PER_S)
                self._jogging = False
        await person.close()

    # Stages

    def _heard(self, asked: Asked) -> None:
        """Note that a request to a member was sent or answered. Runs in the coordinator's process."""
        if asked.verb == "lease":
            return
        at = self._reached.setdefault((asked.step, asked.member), {})
        now_ns = self._clock.now_ns()
        at.setdefault(asked.verb, now_ns)
        if asked.verb == "home" and asked.answered_ns is not None:
            at["homed"] = now_ns
        if asked.verb == "go" and asked.taken:
            at.setdefault("fire", now_ns)
            at.setdefault("t0", self._host_ns(asked))
        if self._target is None:
            return
        act, cell, reached = self._target
        if asked.job not in act.jobs or asked.member != act.member or reached.done():
            return
        at_ns = self._strikes_at(cell.stage, asked, now_ns)
        if at_ns is not None:
            self._target = None
            step = asked.step
            self._clock.call_at_ns(
                at_ns, lambda: None if reached.done() else reached.set_result(step), context=Context()
            )

    def _strikes_at(self, stage: Stage, asked: Asked, now_ns: int) -> int | None:
        """Return the instant of the fault as soon as it is determined."""
        going_out = asked.answered_ns is None
        if stage == "home" and asked.verb == "home" and going_out:
            return now_ns + self._draw.randrange(self._homes_in_ns(asked.member) + 1)
        if stage in _WITHIN and asked.verb == stage and going_out:
            return now_ns + self._draw.randint(*_WITHIN[stage])
        if stage == "arm" and asked.verb == "arm" and going_out:
            return now_ns + self._draw.randrange(self._arms_in_ns(asked.member) + 1)
        if asked.verb != "go" or not asked.taken:
            return None
        t0_ns = self._host_ns(asked)
        if stage == "fire":
            return self._draw.randint(min(now_ns, t0_ns), t0_ns + _FIRE_NS)
        if stage == "motion":
            return t0_ns + self._draw.randint(*_MOTION_NS)
        return None

    def _homes_in_ns(self, member: str) -> int:
        """Return the shortest expected homing time: a share of the shortest one so far, and of the path from the
        current position."""
        config = self._story.fleet.controllers[member]
        if config.adapter == "ppsmc":
            return _VOUCHED_NS
        asked = (each for each in self.witness.of("home") if each.member == member and each.taken)
        shortest_ns = min(each.answered_ns - each.asked_ns for each in asked if each.answered_ns is not None)
        where = self._where()
        ways_s = (
            abs(where[f"{member}.{name}"]) / (axis.homing.speed or axis.limits.velocity / 10)
            for name, axis in config.axes.items()
            if axis.homing.method == "default"
        )
        return round(HOMES_SHARE * (shortest_ns + max(ways_s, default=0.0) * NS_PER_S))

    def _arms_in_ns(self, member: str) -> int:
        """Return the duration of the member's last arming; before the first one, a tenth of the limit that it
        declared."""
        taken = {each.verb: each.reply for each in self.witness.asked if each.member == member and each.taken}
        if "arm" in taken:
            return taken["arm"]["took_ns"]
        return (taken["propose"]["costs"] or {"arm_ns": 0})["arm_ns"] // 10

    def _stage_of(self, step: tuple[str, int], member: str) -> Stage | None:
        """Return the stage that `member` has reached in the step; None when its job has ended."""
        row = self.virtual.journal.load_record(step[0])
        if row is None or row.state in FINISHED_STATES:
            return None
        at = self._reached[step, member]
        if "home" in at:
            return None if "homed" in at else "home"
        if "t0" in at and self._clock.now_ns() > at["t0"] + _FIRE_NS:
            return "motion"
        return next(stage for stage in reversed(STAGES) if stage in at)

    def _host_ns(self, asked: Asked) -> int:
        origin_ns = next(
            c.leadership.scale.origin_host_ns for _, c in self.virtual.coordinators.values() if c.leadership.epoch
        )
        return asked.said["t0_fleet_ns"] + origin_ns

    # Checks during a run

    def _hear_state(self, sample: Sample) -> None:
        """Check invariant 9: no adapter goes back to an older epoch."""
        _, _, rest = sample.payload.partition(b'"epoch":')
        epoch = int(rest[: rest.index(b",")])
        if epoch < self._epochs.get(sample.key, 0):
            self.judge.violate("9", f"{sample.key}: epoch {epoch} after {self._epochs[sample.key]}")
        self._epochs[sample.key] = epoch

    async def _judge_latches(self, fault: str) -> None:
        """Check invariant 4: every reachable adapter latches an e-stop, without a coordinator."""
        if fault != "estop":
            return
        person = self.virtual.client("looker")
        for name, state in (await person.status(1.0)).items():
            if state.estop is None:
                self.judge.violate("4", f"{name} has not latched the e-stop")
        await person.close()

    def _judge_reigns(self) -> None:
        """Check invariant 9: the leaders have different epochs, and an overtaken coordinator has detected its loss
        of leadership."""
        epochs = [each.leadership.epoch for _, each in self.virtual.coordinators.values() if each.leadership.epoch]
        if len(set(epochs)) != len(epochs):
            self.judge.violate("9", f"two leaders with one epoch: {epochs}")
        for name in self._breaker.overtaken:
            if not self.virtual.coordinators[name][1].leadership.over:
                self.judge.violate("9", f"coordinator {name} was overtaken but still acts as leader")
