"""The forecast of a job: positions, limits, names, units and durations of all steps, before anything moves.

Positions that only the machine knows are carried as distances from there, so that a sum of relative moves is compared
with the soft limits although nothing is known about its beginning.
"""

from collections.abc import Callable, Generator, Iterable, Sequence

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import JobForecast, StepForecast
from orchestrator.model.positions.resolve import PositionResolver, list_file_positions
from orchestrator.model.steps.base import Step
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.repeated import forecast_in_parts
from orchestrator.plan.forecast.state import ForecastState


class JobForecaster(ForecastState):
    """Runs the steps of a job forward one by one; `problems` and `conditions` grow, `axes` is the state after the last
    one, `motion` its motion, if all its positions are known."""

    def take(self, index: int, step: Step) -> StepForecast:
        """Run one step forward. index: its number in the job file."""
        work = self.take_in_parts(index, step)
        while True:
            try:
                next(work)
            except StopIteration as stop:
                return stop.value

    def take_in_parts(self, index: int, step: Step) -> Generator[None, None, StepForecast]:
        """`take`, with a break before each step inside a repeat or a scan, for the other work of a process."""
        self.notes, self.bounds, self.followers, self.racks, self.pairs = {}, {}, {}, {}, {}
        self.motion = None
        span = yield from forecast_in_parts(self, ForecastContext(index, ("steps", index)), step)
        is_line = step.is_single and self.motion is not None and self.motion.line is not None
        if not step.is_motion and not is_line:
            self.motion = None
        path = None if self.motion is None or self.motion.path is None else self.motion.path.report
        return StepForecast(
            index=index,
            do=step.kind,
            text=step.describe(),
            least_s=round(span.least, 6),
            most_s=None if span.most is None else round(span.most, 6),
            conditions=list(self.notes),
            bounds=self.bounds,
            followers=self.followers,
            racks=self.racks,
            pairs=self.pairs,
            path=path,
            lines="" if self.motion is None else self.motion.line_words,
        )

    def add_refusal(self, index: int, error: Refusal) -> None:
        """Add a problem of a whole step. index: its number in the job file."""
        self.add_problem(ForecastContext(index, ("steps", index)), (), Refusal(error.code, error.text, error.remedy))

    def finish(self, steps: Iterable[StepForecast] = ()) -> JobForecast:
        """The forecast of the job whose steps were taken."""
        for name, state in self.axes.items():
            self.note_room(name, state)
        return JobForecast(steps=list(steps), problems=self.problems, conditions=list(self.conditions))


def forecast_job(
    fleet: Fleet, steps: Sequence[Step], repeat: int = 1, on_step: Callable[[int], None] | None = None
) -> JobForecast:
    """Run all steps forward from an unknown beginning, by the positions of the fleet file. on_step: called with the
    number of steps done."""
    forecaster = JobForecaster(fleet)
    resolver = PositionResolver(fleet, list_file_positions(fleet), keep_unknown=True)
    forecasts: list[StepForecast] = []
    for _ in range(repeat):
        for index, step in enumerate(steps):
            try:
                known_step = resolver.resolve_step(step)
            except Refusal as error:
                forecaster.add_refusal(index, error)
                known_step = step
            forecasts.append(forecaster.take(index, known_step))
            if on_step is not None:
                on_step(len(forecasts))
    return forecaster.finish(forecasts)
