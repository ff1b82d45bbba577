"""What requests return to people: the same models, with tables for a notebook and pictures.

Rendering is imported when it is used: a program that only sends requests needs none of it.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from orchestrator.model.errors import Refusal
from orchestrator.model.report import JobReport, PointRecord, QueueEntry, QueueState, StepRecording
from orchestrator.model.state import ControllerState
from orchestrator.model.steps.numbers import name_step

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

WIDTH = 120  # characters of a table
REPR_LENGTH = 300  # characters of a `repr`


def shorten_repr(name: str, words: str) -> str:
    """`<JobResult 'move' done, green, 0.502 s>`, of at most 300 characters."""
    room = REPR_LENGTH - len(name) - 3
    return f"<{name} {words if len(words) <= room else words[: room - 1] + '…'}>"


class FleetStates(dict[str, ControllerState]):
    """The state of every controller, by id. It prints as the table of `tutti status`."""

    def __repr__(self) -> str:
        modes = [f"{name} {state.mode}" for name, state in self.items()]
        return shorten_repr("FleetStates", ", ".join(modes))

    def __str__(self) -> str:
        return _render_text(self._make_table())

    def _repr_html_(self) -> str:
        return _render_html(self._make_table())

    def _make_table(self) -> "RenderableType":
        from orchestrator.monitor.fleet_view import make_state_table

        return make_state_table(self)


class JobQueue(QueueState):
    """A list of jobs: iterate over its entries. It prints as a table."""

    def __iter__(self) -> Iterator[QueueEntry]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return iter(self.jobs)

    def __len__(self) -> int:
        return len(self.jobs)

    def __getitem__(self, index: int) -> QueueEntry:
        return self.jobs[index]

    def __repr__(self) -> str:
        jobs = [f"{entry.name!r} {entry.state}" for entry in self.jobs]
        return shorten_repr("JobQueue", f"{self.total} jobs: {', '.join(jobs)}" if jobs else "no jobs")

    def __str__(self) -> str:
        return _render_text(self._make_table())

    def _repr_html_(self) -> str:
        return _render_html(self._make_table())

    def _make_table(self) -> "RenderableType":
        from orchestrator.monitor.queue_words import make_queue_table

        return make_queue_table(self)


class JobResult(JobReport):
    """The record of a job that has ended. It prints as the table of `tutti job report`, and is a data frame on demand.

    recordings: plan and polled positions of its first 100 motion steps, as far as they are kept. points: what was
    recorded at the points of its scans, the first 10,000.
    """

    recordings: tuple[StepRecording, ...] = Field(default=(), exclude=True, repr=False)
    points: tuple[PointRecord, ...] = Field(default=(), exclude=True, repr=False)

    @classmethod
    def of(
        cls, report: JobReport, recordings: Sequence[StepRecording], points: Sequence[PointRecord] = ()
    ) -> "JobResult":
        """A result of `report` with the recordings of its motion steps, and the points of its scans."""
        return cls.model_validate({**dict(report), "recordings": tuple(recordings), "points": tuple(points)})

    def __repr__(self) -> str:
        words = [f"{self.name!r} {self.state}"]
        verdict = self.judge().verdict
        words += [verdict] if verdict is not None else []
        moved_s = sum(step.actual_s or 0.0 for step in self.steps)
        words += [f"{moved_s:.3f} s"] if moved_s else []
        words += [self.reason] if self.reason else []
        return shorten_repr("JobResult", ", ".join(words))

    def to_dataframe(self, library: str | None = None) -> Any:
        """Its moves as a data frame: one row for each axis of each motion step.

        Starts and ends are intervals of fleet time that contain the true instants, `start_t_lo_ns` to `start_t_hi_ns`.
        library: `pandas` or `polars`; None: whichever is installed. Raises `NoDataFrames`.
        """
        from orchestrator.monitor.export.dataframe import make_dataframe
        from orchestrator.monitor.export.moves import make_moves_table

        return make_dataframe(make_moves_table(self), library)

    def points_to_dataframe(self, library: str | None = None) -> Any:
        """Its `points` as a data frame, with the columns of `tutti job points --csv`. library: as in `to_dataframe`.
        Raises `NoDataFrames`."""
        from orchestrator.monitor.export.dataframe import make_dataframe
        from orchestrator.monitor.export.points import make_points_table

        return make_dataframe(make_points_table(self.points, {}), library)

    def __str__(self) -> str:
        return _render_text(self._make_table())

    def _repr_html_(self) -> str:
        return _render_html(self._make_table())

    def _make_table(self) -> "RenderableType":
        from orchestrator.monitor.report_table import make_report_tables

        return make_report_tables(self)

    def plot(self, path: Path | str | None = None) -> "Figure":
        """Plot the planned and the polled positions of its axes over time, their difference, and starts and ends as
        intervals; of a job with scans, the planned and measured points of the first one. A notebook shows it.

        path: also write it there, as PNG or SVG by its ending. Raises `Refusal`, code `no-recording`, if nothing was
        recorded: a job without a move, or an old one.
        """
        from orchestrator.monitor.job_plot import plot_recordings

        if self.points:
            from orchestrator.monitor.scan_points import plot_points

            first = [point for point in self.points if point.step == self.points[0].step]
            title = f"{self.name} {self.job_id}: {len(first)} points of {name_step(first[0].step)}"
            return plot_points(first, title, None if path is None else Path(path))
        if not self.recordings:
            raise Refusal("no-recording", f"job {self.name!r} has no recording of a move", "plot a job that moves axes")
        title = f"{self.name} {self.job_id}: planned and polled positions"
        return plot_recordings(self.recordings, title, None if path is None else Path(path), self.steps)


def _render_text(table: "RenderableType") -> str:
    console = _make_console()
    console.print(table)
    return console.export_text().rstrip()


def _render_html(table: "RenderableType") -> str:
    console = _make_console()
    console.print(table)
    return console.export_html(inline_styles=True, code_format='<pre style="line-height: 1.3">{code}</pre>')


def _make_console() -> Any:
    import io

    from rich.console import Console

    return Console(record=True, width=WIDTH, file=io.StringIO())
