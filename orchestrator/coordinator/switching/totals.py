"""What an output with a trigger did in a step, summed up; of a path that was braked and went on, over all its parts."""

from dataclasses import dataclass, field

from orchestrator.model.report import StepReport, TriggerReport, TriggerRow

REPORTED_ROWS = 20
UNKNOWN = "of one more edge it is not known whether it happened"


@dataclass(slots=True)
class TriggerTotals:
    """The rows of one output so far. skipped: of those that are not seen, how many a stopping tail of a path has
    passed. left: instants of the plan that have no row yet. refused: why nothing is known of the last part. wrong:
    numbers of rows, from 1, whose edges were not seen, or not within the promise."""

    output: str
    rows: int = 0
    seen: int = 0
    outside: int = 0
    widest_ns: int = 0
    skipped: int = 0
    left: int = 0
    unknown: bool = False
    refused: str = ""
    wrong: set[int] = field(default_factory=set[int])
    first_rows: list[TriggerRow] = field(default_factory=list[TriggerRow])

    def add_row(self, row: TriggerRow) -> None:
        """Add the next row."""
        self.rows += 1
        if len(self.first_rows) < REPORTED_ROWS:
            self.first_rows.append(row)
        if row.seen is None:
            self.wrong.add(row.number)
            return
        self.seen += 1
        if row.seen.latest_ns < row.earliest_ns or row.seen.earliest_ns > row.latest_ns:
            self.outside += 1
            self.wrong.add(row.number)
        self.widest_ns = max(self.widest_ns, row.seen.latest_ns - row.seen.earliest_ns)

    def make_report(self) -> TriggerReport:
        """What the report of the step states of it."""
        skipped_text = f"{self.skipped} not played, because the path was being braked there"
        problems = [skipped_text] if self.skipped else []
        problems += [self.refused] if self.refused else [UNKNOWN] if self.unknown else []
        return TriggerReport(
            output=self.output,
            planned=self.rows + self.left,
            seen=self.seen,
            outside=self.outside,
            widest_ns=self.widest_ns,
            rows=self.first_rows,
            problem="; ".join(problems),
        )


def judge_triggers(report: StepReport, triggers: list[TriggerReport]) -> StepReport:
    """The report with its triggers. A step that is done although triggers were missed differs from its plan."""
    deviations = list(report.deviations)
    for trigger in triggers if report.state == "done" else ():
        if trigger.seen < trigger.planned:
            text = f"{trigger.output}: {trigger.seen} of {trigger.planned} triggers are known to have happened"
            deviations.append(text + (f" ({trigger.problem})" if trigger.problem else ""))
        if trigger.outside:
            deviations.append(
                f"{trigger.output}: {trigger.outside} of {trigger.planned} triggers were not within the promise"
            )
    worse = deviations != report.deviations and report.verdict != "none"
    update = {"triggers": triggers, "deviations": deviations, "verdict": "red" if worse else report.verdict}
    return report.model_copy(update=update)
