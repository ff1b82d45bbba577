"""One seeded run of a simulated fleet with a fault at a chosen stage, judged by the simulators' own truth.

A run homes the fleet, starts one synchronised move, breaks something at a random instant of one stage, lets the
dust settle, and then holds what really moved against the invariants of the design (section 7).
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Literal

from orchestrator.bus.base import Priority, Sample
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.lab.virtual import VirtualFleet
from orchestrator.model.fleet import Fleet, by_line
from orchestrator.model.job import Job
from orchestrator.model.messages import Estop
from orchestrator.model.report import ENDED, JobReport, Progress, StepReport
from orchestrator.model.state import Interval
from sim.core.controller import Motion

Stage = Literal["propose", "arm", "commit", "go", "fire", "motion"]
STAGES: tuple[Stage, ...] = ("propose", "arm", "commit", "go", "fire", "motion")

# When, after the job's state has changed, a stage lies: (state, earliest, latest) in ns.
_STAGE_AT: dict[Stage, tuple[str, int, int]] = {
    "propose": ("planning", 0, 12 * NS_PER_MS),
    "arm": ("arming", 0, 60 * NS_PER_MS),
    "commit": ("armed", 0, 12 * NS_PER_MS),
    "go": ("committed", 0, 8 * NS_PER_MS),
    "fire": ("running", 0, 400 * NS_PER_MS),
    "motion": ("running", 400 * NS_PER_MS, 2500 * NS_PER_MS),
}

FAULTS = (
    "none",
    "host-killed",
    "host-hung",
    "link-cut",
    "link-closed",
    "garbage",
    "silence",
    "power-off",
    "limit",
    "stop",
    "estop",
    "coordinator-killed",
    "coordinator-hung",
    "bus-cut",
)

# What nobody can notice before the member is told to go, or before it moves: the others start with it and are stopped.
LATENT = frozenset({"limit", "link-cut", "garbage", "silence"})

# The longest that anything goes on after a fault, before its ramp: a silent adapter is noticed after 0.7 s (a hung
# one's guardian is quicker), then the others are told.
DETECTION_NS = 1000 * NS_PER_MS
STAND_STILL_NS = 8 * NS_PER_S


@dataclass(slots=True)
class Story:
    """What happened in one run, which took fleet_s of virtual time."""

    seed: int
    stage: Stage
    fault: str
    member: str
    lines: list[str] = field(default_factory=list[str])
    violations: list[str] = field(default_factory=list[str])
    state: str = ""
    moved: bool = False
    fleet_s: float = 0.0

    def tell(self) -> str:
        """The story, shortened, for a failing test."""
        head = f"seed {self.seed}: {self.fault} of {self.member} at {self.stage}; job {self.state}; {self.violations}"
        return "\n".join([head, *self.lines[-40:]])


def run_seed(fleet: Fleet, prepare: Job, move: Job, seed: int, stage: Stage, fault: str) -> Story:
    """Run one seed. `prepare` enables and homes; `move` is one step that moves."""
    story = Story(seed, stage, fault, "")

    async def main(clock: VirtualClock) -> None:
        run = _Run(fleet, clock, story)
        try:
            await run.play(prepare, move)
        finally:
            story.lines = run.fleet.lines
            story.fleet_s = clock.now_ns() / NS_PER_S

    run_virtual(main)
    return story


class _Run:
    """The fleet of one seed."""

    def __init__(self, fleet: Fleet, clock: VirtualClock, story: Story) -> None:
        self.draw = Random(story.seed)
        self.clock = clock
        self.story = story
        self.fleet = VirtualFleet(fleet, clock, story.seed)
        self.broken_ns: int | None = None
        self.deaf: set[str] = set()
        self.resting: set[str] = set()
        self.stage_reached: asyncio.Future[None]
        story.member = self.draw.choice(list(fleet.controllers))

    async def play(self, prepare: Job, move: Job) -> None:
        await self.fleet.start()
        client = self.fleet.client()
        report = await client.wait(await client.submit(prepare))
        if report.state != "done":
            self.story.violations.append(f"the preparation is {report.state}: {report.reason}")
            return
        homed = {name: len(each.motions) for name, each in self.fleet.controllers.items()}
        await self._watch_for_stage()
        job_id = await client.submit(move)
        await self.stage_reached
        await self._break_in_stage()
        await self._until_ended(job_id)
        await sleep_ns(self.clock, STAND_STILL_NS)
        await self._see_who_rests()
        motions = {name: each.motions[homed[name] :] for name, each in self.fleet.controllers.items()}
        self.story.moved = any(motions.values())
        row = self.fleet.journal.row(job_id)
        self.story.state = row.state if row else "unknown"
        report = self.fleet.journal.report(job_id)
        self._judge(job_id, motions, report)

    # The fault

    async def _watch_for_stage(self) -> None:
        """Look out, from now on, for the job state in which the stage lies."""
        state = _STAGE_AT[self.story.stage][0]
        self.stage_reached = asyncio.get_running_loop().create_future()

        def look(sample: Sample) -> None:
            progress = Progress.model_validate_json(sample.payload)
            if not self.stage_reached.done() and (progress.state == state or progress.state in ENDED):
                self.stage_reached.set_result(None)

        await self.fleet.client("watcher").bus.subscribe(self.fleet.keys.job_state(), look)

    async def _break_in_stage(self) -> None:
        """Draw an instant within the stage, and break what the story says."""
        _, earliest_ns, latest_ns = _STAGE_AT[self.story.stage]
        await sleep_ns(self.clock, self.draw.randrange(earliest_ns, latest_ns + 1))
        self.broken_ns = self.clock.now_ns()
        await self._break()

    async def _break(self) -> None:
        fleet, member = self.fleet, self.story.member
        wire = fleet.wires[member]
        host = f"host/{fleet.fleet.controllers[member].host}"
        acts: dict[str, Callable[[], object]] = {
            "host-killed": lambda: fleet.kill(host),
            "host-hung": lambda: fleet.freeze(host),
            "link-cut": lambda: setattr(wire, "cut", True),
            "link-closed": lambda: [link.hang_up() for link in list(wire.links)],
            "garbage": lambda: setattr(wire, "to_near", self._garble),
            "silence": lambda: fleet.freeze(f"sim/{member}"),
            "power-off": lambda: fleet.within(member, lambda each: each.set_power(False)),
            "limit": lambda: fleet.within(member, lambda each: each.set_limit(each.axes[0], "both")),
            "coordinator-killed": lambda: fleet.kill("coordinator/first"),
        }
        fault = self.story.fault
        if fault in ("link-cut", "garbage", "silence"):
            # One wire and one simulator may carry several controllers.
            self.deaf |= set(self._line_of(member))
        if fault == "power-off":
            # A unit that is off takes those behind it off the line: nobody but they themselves can stop them.
            line = self._line_of(member)
            self.deaf |= set(line[line.index(member) + 1 :])
        if fault == "none":
            return
        if fault in acts:
            acts[fault]()
        elif fault == "stop":
            client = fleet.client("stopper")
            await client.stop()
            await client.close()
        elif fault == "estop":
            client = fleet.client("stopper")
            client.bus.put(fleet.keys.estop, Estop(event="e1", actor="test").to_json(), Priority.ESTOP)
        elif fault == "coordinator-hung":
            fleet.freeze("coordinator/first")
            await sleep_ns(self.clock, 1500 * NS_PER_MS)
            fleet.start_coordinator("second")
            await sleep_ns(self.clock, 2500 * NS_PER_MS)
            fleet.resume("coordinator/first")
        elif fault == "bus-cut":
            fleet.net.partition({fleet.process(host).name}, {fleet.process("coordinator/first").name})
        else:
            raise ValueError(f"unknown fault {fault!r}; known: {', '.join(FAULTS)}")

    def _line_of(self, member: str) -> list[str]:
        """The controllers on the line of `member`, the host's first."""
        return next(names for names in by_line(self.fleet.fleet) if member in names)

    def _garble(self, data: bytes) -> bytes:
        return bytes(self.draw.randrange(256) for _ in data)

    async def _until_ended(self, job_id: str) -> None:
        """Wait until the journal says that the job has ended, or nobody is left to say it."""
        for _ in range(600):
            row = self.fleet.journal.row(job_id)
            if row is None or row.state in ENDED:
                return
            await sleep_ns(self.clock, 50 * NS_PER_MS)

    async def _see_who_rests(self) -> None:
        """A controller that decodes a poll at this very moment is not at rest for a while: look more than once."""
        for _ in range(40):
            self.resting |= {name for name, each in self.fleet.controllers.items() if each.at_rest()}
            await sleep_ns(self.clock, 3 * NS_PER_MS)

    # The judgement

    def _judge(self, job_id: str, motions: Mapping[str, Sequence[Motion]], report: JobReport | None) -> None:
        violate = self.story.violations.append
        decided = bool(self.fleet.journal.decisions(job_id))
        for name, made in motions.items():
            if not decided and made:
                violate(f"invariant 1/2: {name} moved, but nothing was decided")
            if name not in self.resting | self.deaf:
                violate(f"invariant 3: {name} is not at rest {STAND_STILL_NS / NS_PER_S} s after the end")
            for motion in made:
                self._judge_motion(name, motion)
        if self.story.fault == "none" and self.story.state != "done":
            violate(f"nothing was broken, and the job is {self.story.state}: {report.reason if report else ''}")
        if report is not None and report.state == "done":
            self._judge_evidence(report.steps[0], motions)
        self._judge_epochs()

    def _judge_motion(self, name: str, motion: Motion) -> None:
        """Invariants 3 and 5 for one motion."""
        violate, fleet = self.story.violations.append, self.fleet.fleet
        axis = next((a for a in fleet.controllers[name].axes.values() if a.motors[0] == motion.axis), None)
        if axis is None:
            violate(f"{name}: motor {motion.axis} moved, which no axis has")
            return
        broken_ns, end_ns = self.broken_ns, motion.end_ns
        if end_ns is None and name not in self.deaf:
            violate(f"invariant 3: {name}.{motion.axis} never ended its motion")
        ramp_ns = round(axis.limits.velocity / axis.limits.acceleration * NS_PER_S)
        if broken_ns is not None and end_ns is not None and name not in self.deaf:
            since_ns = max(broken_ns, motion.start_ns) if self.story.fault in LATENT else broken_ns
            longest_ns = since_ns + DETECTION_NS + ramp_ns
            # Without a failure that the fleet can notice (a fault that came too late) the move may simply end.
            if end_ns > longest_ns and self.story.state != "done":
                violate(
                    f"invariant 3: {name}.{motion.axis} moved {(end_ns - broken_ns) / NS_PER_S:.3f} s after the fault"
                )
        limits = axis.soft_limits_counts
        if limits is not None and motion.end_counts is not None:
            low, high = limits
            if not low - 1 <= motion.end_counts <= high + 1:
                violate(f"invariant 5: {name}.{motion.axis} went to {motion.end_counts}; limits {low} to {high}")

    def _judge_evidence(self, step: StepReport, motions: Mapping[str, Sequence[Motion]]) -> None:
        """Invariant 8: every claimed interval contains the truth."""
        origin_ns = self.fleet.coordinators["first"][1].throne.scale.origin_host_ns
        for name, member in step.members.items():
            axes = self.fleet.fleet.controllers[name].axes
            for axis, evidence in member.evidence.items():
                truth = next((m for m in motions[name] if m.axis == axes[axis].motors[0]), None)
                if truth is None:
                    self.story.violations.append(f"invariant 8: {name}.{axis} claims a start and did not move")
                    continue
                self._contain(f"{name}.{axis} start", evidence.start, truth.start_ns - origin_ns)
                self._contain(f"{name}.{axis} modelled start", evidence.judged_start, truth.start_ns - origin_ns)
                if evidence.end is not None and truth.end_ns is not None:
                    self._contain(f"{name}.{axis} end", evidence.end, truth.end_ns - origin_ns)

    def _contain(self, what: str, claimed: Interval, truth_ns: int) -> None:
        if not claimed.earliest_ns <= truth_ns <= claimed.latest_ns:
            self.story.violations.append(
                f"invariant 8: {what} at {truth_ns}, claimed {claimed.earliest_ns} to {claimed.latest_ns}"
            )

    def _judge_epochs(self) -> None:
        """Invariant 9: the reigns have different epochs, and an overtaken coordinator knows that it is."""
        epochs = [each.throne.epoch for _, each in self.fleet.coordinators.values() if each.throne.epoch]
        if len(set(epochs)) != len(epochs):
            self.story.violations.append(f"invariant 9: two reigns with one epoch: {epochs}")
        if self.story.fault == "coordinator-hung" and not self.fleet.coordinators["first"][1].throne.over:
            self.story.violations.append("invariant 9: the overtaken coordinator believes that it reigns")
