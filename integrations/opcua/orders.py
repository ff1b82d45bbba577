"""Job orders: what they ask for, and what has become of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from integrations.opcua.states import NEW, OrderState
from integrations.opcua.work_masters import choose_work_master
from tutti import Job, JobReport, QueueTerms, Refusal, Template

ORDER_KEY, MASTER_KEY = "JobOrderID", "WorkMasterID"
"""Beside the parameters that a job was made of; those of templates begin with small letters."""
MAX_ID = 120  # characters
PRIORITIES = range(-100, 101)


@dataclass(frozen=True, slots=True)
class OrderParameter:
    """A parameter as a client gives it. unit: of the number; empty: that of the template."""

    name: str
    value: bool | int | float | str
    unit: str = ""

    @property
    def written(self) -> bool | int | float | str:
        """The value as a job file has it."""
        return f"{self.value} {self.unit}" if self.unit else self.value


@dataclass(frozen=True, slots=True)
class OrderRequest:
    """What a client orders. start: not before, with its offset from UTC. unmet: kinds of requirements that it states,
    of which nothing is known here."""

    id: str
    work_masters: tuple[str, ...] = ()
    parameters: tuple[OrderParameter, ...] = ()
    priority: int | None = None
    start: datetime | None = None
    description: str = ""
    unmet: tuple[str, ...] = ()

    def make_job(self, templates: Mapping[str, Template], now: datetime) -> tuple[Job, QueueTerms]:
        """The job, and its terms in the queue but `held`; a start that is over is as soon as possible. Raises
        `Refusal`, code `bad-order`, and `FileError` with every wrong parameter."""
        if not 1 <= len(self.id) <= MAX_ID or not self.id.isprintable():
            raise Refusal("bad-order", "the JobOrderID is no name", f"write 1 to {MAX_ID} printable characters")
        if self.unmet:
            text = f"job order {self.id} has {', '.join(self.unmet)}, which this fleet does not know"
            raise Refusal("bad-order", text, "leave them out; axes are named in the template")
        if self.priority is not None and self.priority not in PRIORITIES:
            raise Refusal("bad-order", f"priority {self.priority} is out of range", "choose -100 to 100")
        master = choose_work_master(templates, self.work_masters)
        names = [parameter.name for parameter in self.parameters]
        if len(set(names)) < len(names):
            raise Refusal("bad-order", f"job order {self.id} states a parameter twice", "state each once")
        job = templates[master].fill({parameter.name: parameter.written for parameter in self.parameters})
        used = {**job.parameters_used, ORDER_KEY: self.id, MASTER_KEY: master}
        begins = self.start if self.start is not None and self.start > now else None
        terms = QueueTerms(priority=self.priority or 0, at=None if begins is None else begins.isoformat(), missed="run")
        return job.model_copy(update={"parameters_used": used}), terms

    @classmethod
    def of(cls, job: Job, terms: QueueTerms) -> "OrderRequest | None":
        """The order that a job was made of; None for another job."""
        used = dict(job.parameters_used)
        order_id, master = used.pop(ORDER_KEY, None), used.pop(MASTER_KEY, None)
        if order_id is None or master is None:
            return None
        parameters = tuple(OrderParameter(name, text) for name, text in used.items())
        start = None if terms.at is None else datetime.fromisoformat(terms.at)
        return cls(order_id, (master,), parameters, terms.priority, start)


@dataclass(slots=True)
class Order:
    """An order, and the job that it has become. comment: the last one of a client. seen: how many transitions of the
    job are known; known: what the list of jobs said of it when they were read."""

    request: OrderRequest
    job_id: str
    state: OrderState = NEW
    reason: str = ""
    comment: str = ""
    began_utc: str | None = None
    report: JobReport | None = None
    is_stopping: bool = False
    is_aborting: bool = False
    seen: int = 0
    known: object = None

    def list_results(self) -> dict[str, bool | int | float | str]:
        """What a response says besides its state, by the names of its data."""
        results: dict[str, bool | int | float | str] = {"JobID": self.job_id}
        results |= {"Reason": self.reason} if self.reason else {}
        results |= {"Comment": self.comment} if self.comment else {}
        return results if self.report is None else results | list_figures(self.report)


def list_figures(report: JobReport) -> dict[str, bool | int | float | str]:
    """What a job did: its verdict, an upper bound of its start skews in seconds, and the points of its scans."""
    figures: dict[str, bool | int | float | str] = {"Verdict": report.verdict or "none"}
    figures |= {"VerdictReason": report.verdict_reason} if report.verdict_reason else {}
    skews_ns = [step.narrowest_skew.at_most_ns for step in report.steps if step.narrowest_skew is not None]
    scans = [step.scan for step in report.steps if step.scan is not None]
    skews_ns += [scan.start_skew_worst_ns for scan in scans if scan.start_skew_worst_ns is not None]
    figures |= {"StartSkewAtMost": max(skews_ns) / 1e9} if skews_ns else {}
    if scans:
        figures |= {"PointsDone": sum(scan.done for scan in scans), "Points": sum(scan.points for scan in scans)}
    return figures
