"""The terms on which a motion waits armed, and where such a wait may stand."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Protocol


@dataclass(frozen=True, slots=True)
class ArmedTerms:
    """What a motion that is loaded waits for. input: `controller.input`; None: a request, which starts it in any case.
    value: the level that the input must take. level: it may have that level already. timeout_ns: the wait's end."""

    input: str | None
    value: bool
    level: bool
    timeout_ns: int


def describe_armed_obstacle(*, aligns: bool, records: bool) -> str:
    """Why a motion with these options cannot wait armed, with a remedy; empty: it can."""
    if aligns:
        return "`align` delays the start; remove it"
    return "controllers `record` from an instant that is known ahead; remove that" if records else ""


class ArmedStep(Protocol):
    """What is asked of a step here."""

    @property
    def kind(self) -> str: ...

    @property
    def can_wait_armed(self) -> bool: ...

    @property
    def armed_terms(self) -> ArmedTerms | None: ...

    def find_armed_obstacle(self) -> str: ...


def check_armed_waits(steps: Sequence[ArmedStep]) -> None:
    """Raise `ValueError` for a `wait_armed` that does not stand directly before a motion that can wait."""
    for number, (step, next_step) in enumerate(_pair_steps(steps)):
        if step.armed_terms is None:
            continue
        if next_step is None or not next_step.can_wait_armed:
            behind_words = "nothing" if next_step is None else f"`do: {next_step.kind}`"
            raise ValueError(
                f"steps.{number}: `do: wait_armed` stands directly before a move, a path, or a scan that flies, of "
                f"the same list; {behind_words} follows it; move it there, or remove it"
            )
        obstacle = next_step.find_armed_obstacle()
        if obstacle:
            raise ValueError(f"steps.{number + 1}: {obstacle}, and step {number + 1} (wait_armed) has it wait armed")


def _pair_steps(steps: Sequence[ArmedStep]) -> Iterable[tuple[ArmedStep, ArmedStep | None]]:
    """Each step with the one behind it."""
    return zip_longest(steps, steps[1:])
