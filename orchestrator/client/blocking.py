"""The same for scripts and notebooks that have no use for `async`.

with BlockingTutti("tcp/127.0.0.1:7447") as tutti:
    job = tutti.submit(load_job(Path("demo.job.yaml")))
    for event in job.events():
        print(event)
    print(job.result().state)

A loop in a thread of its own does the work, so that it also works where one runs already, as in a notebook. Ctrl-C
gives up waiting, and leaves the job alone.
"""

import asyncio
import threading
from collections.abc import Coroutine, Iterator, Sequence
from typing import Any, Self, TypeVar

from orchestrator.client.api import DEFAULT_ENDPOINT, Tutti
from orchestrator.client.jobs import SubmittedJob
from orchestrator.model.job import Job
from orchestrator.model.messages import Refusal
from orchestrator.model.queue import Terms
from orchestrator.model.report import JobReport, JobState, Lease, Progress, QueueState, Transition
from orchestrator.model.service import AgainReply, JobShown
from orchestrator.model.state import ControllerState, Info

T = TypeVar("T")


class _Worker:
    """An event loop in a thread of its own."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="tutti", daemon=True)
        self._thread.start()

    def do(self, work: Coroutine[Any, Any, T]) -> T:
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result()
        except KeyboardInterrupt:
            future.cancel()
            raise

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class BlockingJob:
    """A submitted job. `id` is its name for everybody."""

    def __init__(self, job: SubmittedJob, worker: _Worker) -> None:
        self._job = job
        self._worker = worker

    @property
    def id(self) -> str:
        return self._job.id

    def events(self) -> Iterator[Transition | Progress]:
        """Every change of its state, and its progress in between, until it has ended. Raises `Refused`."""
        events = self._job.events()
        try:
            while True:
                try:
                    yield self._worker.do(anext(events))
                except StopAsyncIteration:
                    return
        finally:
            self._worker.do(events.aclose())

    def result(self) -> JobReport:
        """Its report, once it has ended. Raises `Refused`."""
        return self._worker.do(self._job.result())

    def show(self) -> JobShown:
        """Everything the journal has of it. Raises `Refused`."""
        return self._worker.do(self._job.show())

    def cancel(self) -> None:
        """Cancel it, queued or running. Raises `Refused`."""
        self._worker.do(self._job.cancel())

    def hold(self) -> None:
        """Keep it from beginning. Raises `Refused`: code `not-queued`."""
        self._worker.do(self._job.hold())

    def release(self) -> None:
        """Let it begin when it is its turn. Raises `Refused`."""
        self._worker.do(self._job.release())

    def pause(self, now: bool = False) -> None:
        """Hold it when its present step has ended, or `now` inside a motion step. Raises `Refused`: `not-running`."""
        self._worker.do(self._job.pause(now))

    def resume(self) -> None:
        """Go on with it. Raises `Refused`: codes `not-running`, `not-paused`."""
        self._worker.do(self._job.resume())


class BlockingTutti:
    """A connection to one fleet; use it as a context. Jogging needs `Tutti`: a hand that blocks can not renew."""

    def __init__(self, connect: str = DEFAULT_ENDPOINT, fleet: str | None = None, actor: str = "api") -> None:
        self._tutti = Tutti(connect, fleet, actor)
        self._worker: _Worker | None = None

    def __enter__(self) -> Self:
        """Connect. Raises `RouterUnreachable`, or `Refused` with code `no-fleet` or `which-fleet`."""
        self._worker = _Worker()
        try:
            self._worker.do(self._tutti.open())
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave. Safe to call twice."""
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.do(self._tutti.close())
            worker.close()

    # Jobs

    def submit(self, job: Job, client_key: str | None = None, terms: Terms | None = None) -> BlockingJob:
        """Submit a job: safe in the journal when this returns. Raises `Refused`."""
        return BlockingJob(self._do(self._tutti.submit(job, client_key, terms)), self._running)

    def job(self, job_id: str) -> BlockingJob:
        """A job by its id."""
        return BlockingJob(self._tutti.job(job_id), self._running)

    def dry_run(self, job: Job) -> dict[str, Any]:
        """What each motion step would take, from where the fleet stands now. Raises `Refused`."""
        return self._do(self._tutti.dry_run(job))

    def jobs(self, limit: int = 50, state: JobState | None = None, name: str = "") -> QueueState:
        """The newest jobs, newest first. Raises `Refused`."""
        return self._do(self._tutti.jobs(limit, state, name))

    def again(self, job_id: str, from_step: int = 0, dry_run: bool = False) -> AgainReply:
        """Do an ended job again, from a step on. Raises `Refused`: codes `not-ended`, `no-step`."""
        return self._do(self._tutti.again(job_id, from_step, dry_run))

    # The fleet

    def status(self) -> dict[str, ControllerState]:
        """The state of every controller that has an adapter now, by id."""
        return self._do(self._tutti.status())

    def info(self, controller: str) -> Info:
        """Who a controller is and what it can do. Raises `Refused`."""
        return self._do(self._tutti.info(controller))

    def leases(self) -> Sequence[Lease]:
        """Who has the axes of each controller now."""
        return self._do(self._tutti.leases())

    def stop(self, mode: str = "decelerate") -> dict[str, Refusal | None]:
        """Stop every controller and the running jobs, and hold what is queued; what each controller answered."""
        return self._do(self._tutti.stop(mode))

    def estop(self, reason: str = "") -> dict[str, bool]:
        """Put an e-stop; which controllers show its latch."""
        return self._do(self._tutti.estop(reason))

    def reset(self, event: str | None = None) -> dict[str, Refusal | None]:
        """Release the e-stop latch if it is safe on all controllers; what each answered."""
        return self._do(self._tutti.reset(event))

    def _do(self, work: Coroutine[Any, Any, T]) -> T:
        return self._running.do(work)

    @property
    def _running(self) -> _Worker:
        if self._worker is None:
            raise RuntimeError("not connected; use it as `with BlockingTutti(…) as tutti:`")
        return self._worker
