"""Triggers in job files: what they may say, and what is refused with place, value and remedy."""

import pytest

from orchestrator.model.errors import TuttiError
from orchestrator.model.jobs.files import parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.triggers import DEFAULT_PULSE_NS, MAX_TRIGGERS


def parse(triggers: str, more: str = "") -> Job:
    steps = f"[{{do: move, to: {{a.x: 1}}, triggers: [{triggers}]}}{more}]"
    return parse_document(f"schema: tutti.job/1\nname: test\nsteps: {steps}\n", Job, "test.yaml")


def test_a_trigger_reads_as_it_is_written() -> None:
    text = "{output: a.lamp, every: 0.1 mm, of: a.x}, {output: b.lamp, at: [10 ms, 1 s], level: true}"
    (step,) = parse(text).steps
    assert isinstance(step, Move)
    first, second = step.triggers
    assert (first.pulse_ns, second.pulse_ns) == (DEFAULT_PULSE_NS, 0)
    assert second.instants_ns == [10_000_000, 1_000_000_000]
    assert step.describe() == "move to a.x=1, a.lamp every 0.1 mm of a.x, b.lamp at 2 places"


@pytest.mark.parametrize(
    ("triggers", "words"),
    [
        ("{output: a.lamp}", "needs either `every` or `at`"),
        ("{output: a.lamp, every: 1 ms, at: [1 ms]}", "needs either `every` or `at`"),
        ("{output: lamp, every: 1 ms}", "write `controller.output`"),
        ("{output: a.lamp, every: 1}", "or name the axis of these positions with `of`"),
        ("{output: a.lamp, every: 1 ms, of: a.x}", "remove `of`"),
        ("{output: a.lamp, every: 0 ms}", "must be above 0"),
        ("{output: a.lamp, every: -1 mm, of: a.x}", "must be above 0"),
        ("{output: a.lamp, at: [2 ms, 1 ms]}", "must grow"),
        ("{output: a.lamp, every: 1 ms, pulse: 0 ms}", "must be above 0"),
        ("{output: a.lamp, every: 1 ms, pulse: 1 ms, level: true}", "remove one of them"),
        ("{output: a.lamp, every: 1 mm, of: a.y}", "axis a.y is not in the step; its axes are a.x"),
        ("{output: a.lamp, every: 1 ms}, {output: a.lamp, every: 2 ms}", "has two triggers"),
        (", ".join(["{output: a.lamp, every: 1 ms}"] * (MAX_TRIGGERS + 1)), "triggers"),
    ],
)
def test_what_a_trigger_cannot_say_is_refused_with_its_place(triggers: str, words: str) -> None:
    with pytest.raises(TuttiError) as refused:
        parse(triggers)
    assert words in str(refused.value) and "steps" in str(refused.value)


def test_an_output_that_the_job_switches_itself_has_no_triggers() -> None:
    with pytest.raises(TuttiError, match=r"steps\.0\.triggers\.0: output a\.lamp is switched by a step"):
        parse("{output: a.lamp, every: 1 ms}", ", {do: output, output: a.lamp, value: false}")
