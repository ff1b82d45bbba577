"""The figures of the journal as statistics of days, and of the whole time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from orchestrator.coordinator.journal.facts import WORST, StatisticsRow
from orchestrator.coordinator.statistics.skew_histogram import SkewHistogram
from orchestrator.model.operation.statistics import AxisFigures, ControllerFigures, PairFigures, PeriodFigures

Figures = dict[str, float]


@dataclass(slots=True)
class _Period:
    """The figures of one period, by kind and subject."""

    subjects: dict[tuple[str, str], Figures] = field(default_factory=dict[tuple[str, str], Figures])

    def add_row(self, row: StatisticsRow) -> None:
        figures = self.subjects.setdefault((row.kind, row.subject), {})
        figure_before = figures.get(row.figure, 0.0)
        figures[row.figure] = (
            max(figure_before, row.value) if row.figure.startswith(WORST) else figure_before + row.value
        )

    def make_figures(self, day: str | None, units: Mapping[str, str]) -> PeriodFigures:
        of_kind: dict[str, dict[str, Figures]] = {}
        for (kind, subject), figures in self.subjects.items():
            of_kind.setdefault(kind, {})[subject] = figures
        return PeriodFigures(
            day=day,
            axes=[
                axis_figures
                for name, values in of_kind.get("axis", {}).items()
                for axis_figures in _make_axis(name, values, units)
            ],
            controllers=[_make_controller(name, values) for name, values in of_kind.get("controller", {}).items()],
            pairs=[_make_pair(name, values) for name, values in of_kind.get("pair", {}).items()],
            jobs=_make_counts(of_kind.get("jobs", {}).get("", {})),
            failures=_make_counts(of_kind.get("failures", {}).get("", {})),
        )


def make_periods(rows: Iterable[StatisticsRow], units: Mapping[str, str]) -> tuple[PeriodFigures, list[PeriodFigures]]:
    """The statistics of all rows, and of each day. units: of the axes now; an axis whose unit has changed has an entry
    for each unit that it has moved in."""
    total, days = _Period(), dict[str, _Period]()
    for row in rows:
        total.add_row(row)
        days.setdefault(row.day, _Period()).add_row(row)
    return total.make_figures(None, units), [days[day].make_figures(day, units) for day in sorted(days)]


def _make_axis(name: str, figures: Figures, units: Mapping[str, str]) -> list[AxisFigures]:
    """The figures of an axis, in the unit that it has now; distances in other units have entries of their own."""
    distances = {figure.partition(" ")[2]: value for figure, value in figures.items() if figure.startswith("distance ")}
    unit = units.get(name) or next(iter(distances), "")
    present = AxisFigures(
        axis=name,
        unit=unit,
        moves=round(figures.get("moves", 0)),
        reversals=round(figures.get("reversals", 0)),
        moving_s=figures.get("moving_s", 0.0),
        distance=distances.pop(unit, 0.0),
    )
    return [
        present,
        *(AxisFigures(axis=name, unit=other_unit, distance=value) for other_unit, value in distances.items()),
    ]


def _make_controller(name: str, figures: Figures) -> ControllerFigures:
    faults = {figure.removeprefix("fault "): value for figure, value in figures.items() if figure.startswith("fault ")}
    times = {figure: figures.get(figure, 0.0) for figure in ("online_s", "fault_s", "offline_s")}
    return ControllerFigures(controller=name, faults=_make_counts(faults), **times)


def _make_pair(name: str, figures: Figures) -> PairFigures:
    histogram, moves = SkewHistogram(), round(figures.get("moves", 0))
    histogram.worst_ns = round(figures.get(f"{WORST}_ns", 0))
    for figure, value in figures.items():
        if figure.startswith("bin "):
            histogram.add_bin(int(figure.removeprefix("bin ")), round(value))
    first, _, second = name.partition("+")
    return PairFigures(
        pair=(first, second),
        moves=moves,
        mean_ns=round(figures.get("sum_ns", 0.0) / max(1, moves)),
        p50_ns=histogram.find_quantile(0.5) or 0,
        p99_ns=histogram.find_quantile(0.99) or 0,
        worst_ns=histogram.worst_ns,
    )


def _make_counts(figures: Figures) -> dict[str, int]:
    return {name: round(value) for name, value in figures.items()}
