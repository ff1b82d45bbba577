"""What follows a motion step in a job: the next motion step, and what happens between the two."""

from dataclasses import dataclass
from typing import Protocol

from orchestrator.coordinator.motion.chain import BetweenSteps
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.steps.armed_terms import ArmedTerms
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.kinds import Motion
from orchestrator.model.steps.numbers import name_step
from orchestrator.model.steps.order import StepPlace
from orchestrator.model.steps.tree import as_motion

BETWEEN_MOST = 20  # steps between two motion steps that are looked at


class NumberedSteps(Protocol):
    """The steps of a job by their numbers."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Step: ...

    def locate(self, index: int) -> StepPlace: ...

    def has_begun(self, place: StepPlace) -> bool: ...


@dataclass(frozen=True, slots=True)
class NextMotion:
    """The motion step `move`, number `index`, and what happens before it."""

    index: int
    move: Motion
    between: BetweenSteps


@dataclass(frozen=True, slots=True)
class ChainBreak:
    """Why the motion step `index` must begin from rest; index is None where none follows, or none so near."""

    index: int | None
    reason: str


def find_next_motion(fleet: Fleet, steps: NumberedSteps, index: int) -> NextMotion | ChainBreak:
    """The motion step behind the one with number `index`. Dwell and outputs do not hinder it."""
    first_motion, pause_ns, acts, obstacle = as_motion(steps[index]), 0, False, ""
    assert first_motion is not None
    for number in range(index + 1, min(len(steps), index + 2 + BETWEEN_MOST)):
        try:
            step = steps[number]
        except KeyError:
            return ChainBreak(number, "its point is not read yet")
        except Refusal as error:
            return ChainBreak(number, error.text)
        if (motion := as_motion(step)) is not None:
            hindrance = obstacle or _find_hindrance(fleet, first_motion, motion)
            return (
                ChainBreak(number, hindrance) if hindrance else NextMotion(number, motion, BetweenSteps(pause_ns, acts))
            )
        if step.pause_ns is None:
            obstacle = obstacle or f"{name_step(number)} ({step.kind}) comes before it"
        else:
            pause_ns += step.pause_ns
            acts = acts or step.acts
    is_farther = len(steps) > index + 2 + BETWEEN_MOST
    return ChainBreak(None, f"more than {BETWEEN_MOST} steps come before it" if is_farther else "")


def find_armed_terms(steps: NumberedSteps, index: int) -> ArmedTerms | None:
    """The terms on which the motion with number `index` waits armed: those of the step directly before it, or before
    the scan that it flies first in."""
    location = steps.locate(index)
    if location.terms_index is None or steps.has_begun(location):
        return None
    try:
        return steps[location.terms_index].armed_terms
    except (KeyError, Refusal):  # a point of a scan that is not in memory any more, a curve that was flown
        return None


def _find_hindrance(fleet: Fleet, moving: Motion, step: Motion) -> str:
    """Why `step` cannot be loaded while `moving` moves; empty if it can."""
    if step.rests or moving.rests:
        return "a path begins and ends at rest"
    if step.measured_targets:
        return "it goes to a position that a probe measures"
    settling = [name for name in moving.find_axes(fleet) if fleet.axis(name).done == "in_position"]
    if settling:
        return f"{settling[0]} must settle in position before it"
    for neighbour, occasion in ((moving, "before it"), (step, "for it")):
        if neighbour.record is not None:
            return f"controllers record positions {occasion} (`record`)"
        if neighbour.triggers:
            return f"outputs are switched on the way {occasion} (`triggers`)"
    if step.align:
        return "it waits for aligned ticks (`align`)"
    return "a trigger line starts it (`start: line`)" if step.start_wish == "line" else ""
