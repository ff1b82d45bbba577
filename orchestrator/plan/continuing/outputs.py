"""The outputs that the steps before a place had left switched, and how they are switched again."""

from collections.abc import Iterator, Mapping, Sequence

from orchestrator.model.numbers import format_ns
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.io import SetOutput


def find_switches(steps: Sequence[Step], repeat: int, index: int, levels: Mapping[str, bool]) -> list[Step]:
    """The steps that switch outputs to what the steps before number `index` have left them at, in their order, each
    with the pause right behind it; none for those that are so now. levels: the present ones."""
    switches: dict[str, list[Step]] = {}
    last_outputs: list[str] = []
    for step in _list_done(steps, repeat, index):
        for output, level in step.left_levels.items():
            switches.pop(output, None)
            if levels.get(output) != level:
                switches[output] = [SetOutput(output=output, value=level)]
        if step.pause_ns and not step.left_levels:
            for output in last_outputs:
                switches[output].append(Dwell(duration=format_ns(step.pause_ns)))
        last_outputs = [output for output in step.left_levels if output in switches]
    return [step for own_steps in switches.values() for step in own_steps]


def _list_done(steps: Sequence[Step], repeat: int, index: int) -> Iterator[Step]:
    """The written steps before number `index`, without the passes that only do the same again."""
    passes, offset = divmod(index, sum(step.step_count for step in steps))
    if passes and repeat > 1:
        for step in steps:
            yield from step.iterate_written()
    for step in steps:
        if offset < step.step_count:
            if step.inner is not None and not step.is_single:
                yield from _list_done(step.inner.steps, step.inner.times, offset)
            return
        yield from step.iterate_written()
        offset -= step.step_count
