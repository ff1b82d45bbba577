"""Questions about the steps of a job, whatever their kinds are."""

from collections.abc import Iterable, Iterator

from orchestrator.model.steps.base import Step
from orchestrator.model.steps.kinds import Motion
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.probe import Probe
from orchestrator.model.steps.scan import Scan


def as_motion(step: Step) -> Motion | None:
    """The step, if it is one motion with an agreed start."""
    return step if isinstance(step, Move | FollowPath) else None


def as_move(step: Step) -> Move | None:
    """The step, if it is a move."""
    return step if isinstance(step, Move) else None


def as_path(step: Step) -> FollowPath | None:
    """The step, if it is a path."""
    return step if isinstance(step, FollowPath) else None


def as_held_probe(step: Step) -> Probe | None:
    """The step, if it is a probe that the coordinator stops."""
    return step if isinstance(step, Probe) and step.is_held else None


def as_live(step: Step) -> Live | None:
    """The step, if it runs what a program asks for."""
    return step if isinstance(step, Live) else None


def iterate_steps(steps: Iterable[Step]) -> Iterator[Step]:
    """All steps as they are written, in the order in which they begin; see `Step.iterate_written`."""
    for step in steps:
        yield from step.iterate_written()


def find_paths(steps: Iterable[Step]) -> list[FollowPath]:
    """All paths as they are written."""
    return [step for step in iterate_steps(steps) if isinstance(step, FollowPath)]


def find_scans(steps: Iterable[Step]) -> list[Scan]:
    """All scans as they are written."""
    return [step for step in iterate_steps(steps) if isinstance(step, Scan)]


def find_digests(steps: Iterable[Step]) -> list[str]:
    """The digests of stored points that steps name, each once."""
    tables = [scan.points for scan in find_scans(steps)]
    return list(dict.fromkeys(table.digest for table in tables if table is not None and table.digest is not None))
