"""The outputs that the steps before a place had left switched, and how they are switched again."""

from collections.abc import Iterator, Mapping, Sequence

from orchestrator.model.steps.base import Step
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.io import SetOutput
from orchestrator.model.steps.repeat import Repeat


def find_switches(steps: Sequence[Step], repeat: int, index: int, levels: Mapping[str, bool]) -> list[Step]:
    """The steps that switch outputs to what the steps before number `index` have left them at, in their order, each
    with the dwell right behind it; none for those that are so now. levels: the present ones."""
    switches: dict[str, list[Step]] = {}
    before: SetOutput | None = None
    for step in _list_done(steps, repeat, index):
        if isinstance(step, SetOutput):
            switches.pop(step.output, None)
            before = step if step.pulse is None else None
            if before is not None:
                switches[step.output] = [step]
        else:
            if isinstance(step, Dwell) and before is not None:
                switches[before.output].append(step)
            before = None
    return [step for output, own in switches.items() if levels.get(output) != own[0].value for step in own]  # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType]


def _list_done(steps: Sequence[Step], repeat: int, index: int) -> Iterator[Step]:
    """The written steps before number `index`, without the passes that only do the same again."""
    size = sum(step.step_count for step in steps)
    passes, offset = divmod(index, size)
    if passes and repeat > 1:
        for step in steps:
            yield from step.iterate_written()
    for step in steps:
        if offset < step.step_count:
            if isinstance(step, Repeat):
                yield from _list_done(step.steps, step.times, offset)
            return
        yield from step.iterate_written()
        offset -= step.step_count
