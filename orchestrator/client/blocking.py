"""The Python API without `async`, for scripts and notebooks.

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
from collections.abc import Callable, Coroutine, Iterator, Sequence
from typing import Any, Self, TypeVar

from orchestrator.client.api import Tutti
from orchestrator.client.connection import DEFAULT_ENDPOINT
from orchestrator.client.jobs import SubmittedJob
from orchestrator.model.errors import Refusal
from orchestrator.model.forecast import JobForecast
from orchestrator.model.job import Job
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobProgress, JobReport, JobState, JobTransition, LeaseState, QueueState
from orchestrator.model.service import JobRetried, JobShown
from orchestrator.model.state import ControllerInfo, ControllerState

T = TypeVar("T")


class _LoopThread:
    """An event loop in a thread of its own."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="tutti", daemon=True)
        self._thread.start()

    def run_coroutine(self, work: Coroutine[Any, Any, T]) -> T:
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
    """A submitted job. `id` identifies it for all clients."""

    def __init__(self, job: SubmittedJob, worker: _LoopThread) -> None:
        self._job = job
        self._worker = worker

    @property
    def id(self) -> str:
        return self._job.id

    def events(self) -> Iterator[JobTransition | JobProgress]:
        """Every change of its state, and its progress in between, until its end. Raises `Refusal`."""
        events = self._job.events()
        try:
            while True:
                try:
                    yield self._worker.run_coroutine(anext(events))
                except StopAsyncIteration:
                    return
        finally:
            self._worker.run_coroutine(events.aclose())

    def result(self) -> JobReport:
        """Wait for its end and return its report. Raises `Refusal`."""
        return self._worker.run_coroutine(self._job.result())

    def show(self) -> JobShown:
        """All details that the journal has. Raises `Refusal`."""
        return self._worker.run_coroutine(self._job.show())

    def cancel(self) -> None:
        """Cancel it, whether queued or running. Raises `Refusal`."""
        self._worker.run_coroutine(self._job.cancel())

    def hold(self) -> None:
        """Hold it in the queue until it is released. Raises `Refusal`: code `not-queued`."""
        self._worker.run_coroutine(self._job.hold())

    def release(self) -> None:
        """Release it, so that it begins in its turn. Raises `Refusal`."""
        self._worker.run_coroutine(self._job.release())

    def pause(self, *, now: bool = False) -> None:
        """Pause it after its current step, or `now`, inside a motion step. Raises `Refusal`: `not-running`."""
        self._worker.run_coroutine(self._job.pause(now=now))

    def resume(self) -> None:
        """Resume it. Raises `Refusal`: codes `not-running`, `not-paused`."""
        self._worker.run_coroutine(self._job.resume())


class BlockingTutti:
    """A connection to one fleet; use it as a context manager. Jogging needs `Tutti`: it is renewed while it lasts."""

    def __init__(self, connect: str = DEFAULT_ENDPOINT, fleet: str | None = None, actor: str = "api") -> None:
        self._tutti = Tutti(connect, fleet, actor)
        self._worker: _LoopThread | None = None

    def __enter__(self) -> Self:
        """Connect. Raises `RouterUnreachable`, or `Refusal` with code `no-fleet` or `which-fleet`."""
        self._worker = _LoopThread()
        try:
            self._worker.run_coroutine(self._tutti.open())
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection. May be called twice."""
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.run_coroutine(self._tutti.close())
            worker.close()

    # Jobs

    def submit(self, job: Job, client_key: str | None = None, terms: QueueTerms | None = None) -> BlockingJob:
        """Submit a job; it is in the journal when this returns. Raises `Refusal`."""
        return BlockingJob(self._run(self._tutti.submit(job, client_key, terms)), self._loop_thread)

    def job(self, job_id: str) -> BlockingJob:
        """A job by its id."""
        return BlockingJob(self._tutti.job(job_id), self._loop_thread)

    def dry_run(self, job: Job, on_steps: Callable[[int], None] | None = None) -> JobForecast:
        """Run a job forward from the present positions, without motion; see `Tutti.dry_run`. Raises `Refusal`."""
        return self._run(self._tutti.dry_run(job, on_steps))

    def list_jobs(self, limit: int = 50, state: JobState | None = None, name: str = "") -> QueueState:
        """The newest jobs, newest first. Raises `Refusal`."""
        return self._run(self._tutti.list_jobs(limit, state, name))

    def retry_job(self, job_id: str, from_step: int = 0, *, dry_run: bool = False) -> JobRetried:
        """Re-run a finished job, from a step on, as a new job. Raises `Refusal`: codes `not-ended`, `no-step`."""
        return self._run(self._tutti.retry_job(job_id, from_step, dry_run=dry_run))

    # The fleet

    def status(self) -> dict[str, ControllerState]:
        """The state of every controller whose adapter is present, by id."""
        return self._run(self._tutti.status())

    def controller_info(self, controller: str) -> ControllerInfo:
        """The identity and abilities of a controller. Raises `Refusal`."""
        return self._run(self._tutti.controller_info(controller))

    def list_leases(self) -> Sequence[LeaseState]:
        """The current leases of the axes."""
        return self._run(self._tutti.list_leases())

    def stop(self, mode: str = "decelerate") -> dict[str, Refusal | None]:
        """Stop every controller and the running jobs, and hold the queued ones; return each controller's reply."""
        return self._run(self._tutti.stop(mode))

    def estop(self, reason: str = "") -> dict[str, bool]:
        """Publish an e-stop; return which controllers show its latch."""
        return self._run(self._tutti.estop(reason))

    def reset(self, event: str | None = None) -> dict[str, Refusal | None]:
        """Release the e-stop latch if it is safe on all controllers; return each controller's reply."""
        return self._run(self._tutti.reset(event))

    def _run(self, work: Coroutine[Any, Any, T]) -> T:
        return self._loop_thread.run_coroutine(work)

    @property
    def _loop_thread(self) -> _LoopThread:
        if self._worker is None:
            raise RuntimeError("not connected; use it as `with BlockingTutti(…) as tutti:`")
        return self._worker
