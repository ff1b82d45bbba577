"""Which step a true motion belongs to, by the recorded requests alone."""

import json
from types import SimpleNamespace
from typing import Any, cast

import pytest

from orchestrator.campaign.faults import FAULTS
from orchestrator.campaign.recording.recorder import BusRecorder
from orchestrator.campaign.records import CampaignPhase, PhaseRecords
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.virtual import VirtualClock, VirtualLoop
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.controller import CommandedMotion

AXES = {"a": "1", "b": "2"}  # axes of controllers c and d, and their motors


class RecordedFleet:
    """Two controllers, c and d; requests and motions are written by the test, instants in ms."""

    def __init__(self) -> None:
        self.loop = VirtualLoop()
        self.motions: dict[str, list[CommandedMotion]] = {"c": [], "d": []}
        self.recorder = BusRecorder(VirtualClock(self.loop), lambda _: None)
        axes = {name: SimpleNamespace(motors=[motor]) for name, motor in AXES.items()}
        leader = SimpleNamespace(leadership=SimpleNamespace(epoch=1, scale=SimpleNamespace(origin_host_ns=0)))
        fleet = SimpleNamespace(
            coordinators={"first": (None, leader)},
            fleet=SimpleNamespace(controllers={name: SimpleNamespace(axes=axes) for name in self.motions}),
            controllers={name: SimpleNamespace(commanded_motions=made) for name, made in self.motions.items()},
        )
        self.records = PhaseRecords(cast(VirtualFleet, fleet), self.recorder)
        jobs = cast(dict[str, Any], dict.fromkeys(("first", "second")))
        self.phase = CampaignPhase(FAULTS["none"], "c", [], dict.fromkeys(self.motions, 0), jobs)

    def request_step(self, job: str, sent_ms: int, t0_ms: int, members: dict[str, str]) -> None:
        """Arm and start a step. members: the axes of each, as letters."""
        self.loop.now_ns = sent_ms * NS_PER_MS
        for verb in ("arm", "go"):
            for name, axes in members.items():
                fields = {"job": job, "step": 0, "t0_fleet_ns": t0_ms * NS_PER_MS}
                more = {"profiles": dict.fromkeys(axes)} if verb == "arm" else {}
                self.recorder.record_requests(f"ctl/{name}/cmd/{verb}", json.dumps(fields | more).encode())

    def move(self, name: str, axis: str, start_ms: int) -> CommandedMotion:
        start_ns = start_ms * NS_PER_MS
        motion = CommandedMotion(AXES[axis], start_ns, 0.0, start_ns + 500 * NS_PER_MS, 1.0)
        self.motions[name].append(motion)
        return motion

    def find_job(self, name: str, axis: str, motion: CommandedMotion) -> str | None:
        """The job of the step that a motion belongs to. The motion is found by that step, and by none that has begun
        before it."""
        steps = self.records.find_steps(self.phase)
        owner = self.records.find_step(name, axis, motion, steps)
        for step in steps:
            if owner is None or (name, axis) not in step.begins_ns:
                continue
            assert step.t0_ns is not None and owner.t0_ns is not None
            found = self.records.find_motions(self.phase, name, axis, (step.job, step.index), step.t0_ns)
            if step.t0_ns <= owner.t0_ns:
                assert (motion in found) == (step is owner)
        return owner.job if owner is not None else None


@pytest.mark.parametrize(
    ("driven", "second_t0_ms", "start_ms", "job"),
    [
        ("", 1100, 1000, "second"),  # c only drives the trigger line of the first step
        ("", 1100, 1100, "second"),
        ("b", 1100, 1000, "second"),  # it moves another axis
        ("a", 1100, 1000, "first"),  # both move this axis: the nearer T0 decides
        ("a", 1100, 1049, "first"),
        ("a", 1100, 1051, "second"),
        ("a", 900, 901, "second"),  # the first was withdrawn; the second was armed to begin sooner
        ("a", 900, 949, "second"),
    ],
)
def test_a_motion_belongs_to_the_step_that_has_its_axis(
    driven: str, second_t0_ms: int, start_ms: int, job: str
) -> None:
    fleet = RecordedFleet()
    fleet.request_step("first", 500, 1000, {"c": driven, "d": "a"})
    fleet.request_step("second", 700, second_t0_ms, {"c": "a"})
    assert fleet.find_job("c", "a", fleet.move("c", "a", start_ms)) == job


def test_a_motion_of_an_axis_that_no_step_has_belongs_to_none() -> None:
    fleet = RecordedFleet()
    fleet.request_step("first", 500, 1000, {"c": "", "d": "a"})
    assert fleet.find_job("c", "a", fleet.move("c", "a", 1000)) is None


def test_a_step_that_is_started_again_has_two_parts() -> None:
    """Of the first part all move, of the second one only c, behind another step of its axis."""
    fleet = RecordedFleet()
    fleet.request_step("first", 500, 1000, {"c": "ab", "d": "a"})
    fleet.request_step("second", 2500, 3000, {"c": "a"})
    fleet.request_step("first", 4500, 5000, {"c": "a"})
    steps = fleet.records.find_steps(fleet.phase)
    assert [(step.job, dict(step.axes)) for step in steps] == [
        ("first", {"c": ["a", "b"], "d": ["a"]}),
        ("second", {"c": ["a"]}),
        ("first", {"c": ["a"]}),
    ]
    for start_ms, number in ((1000, 0), (3000, 1), (5000, 2)):
        assert fleet.records.find_step("c", "a", fleet.move("c", "a", start_ms), steps) is steps[number]
    assert fleet.records.find_step("c", "b", fleet.move("c", "b", 5000), steps) is steps[0]
