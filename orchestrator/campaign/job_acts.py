"""What other clients do with running jobs: start steps that wait armed; pause flights, and change their speed."""

from collections.abc import Collection
from contextlib import suppress
from random import Random

from orchestrator.campaign.recording.recorder import Stage
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.errors import Refusal
from orchestrator.model.report import FINISHED_STATES
from orchestrator.runtime.virtual.fleet import VirtualFleet

_GO_NS = (500 * NS_PER_MS, 4 * NS_PER_S)  # from when a wait was seen to `go`, earliest and latest
FLIGHT_JOB = "main"
_LOOK_NS = 100 * NS_PER_MS
_ACT_NS = (1500 * NS_PER_MS, 6500 * NS_PER_MS)  # from when the job was seen running to an act, earliest and latest
_PAUSE_NS = (100 * NS_PER_MS, 1500 * NS_PER_MS)
_OVERRIDE_NS = (1 * NS_PER_S, 4 * NS_PER_S)
_PERCENTS = (40, 70, 110)

_ACTS = ("pause", "pause-now", "override", "none")


class StartRequests:
    """Sends `go` from now on, if one of `stages` has such steps; in vain if something has ended the wait."""

    def __init__(self, fleet: VirtualFleet, seed: int, stages: Collection[Stage]) -> None:
        self._fleet = fleet
        self._draw = Random(seed)
        self._tasks = TaskOwner()
        if "armed-waiting" in stages:
            self._tasks.spawn(self._run())

    def end(self) -> None:
        """Look for waits no more."""
        self._tasks.cancel_all()

    async def _run(self) -> None:
        client = self._fleet.make_client("starter")
        while True:
            await sleep_ns(self._fleet.clock, _LOOK_NS)
            with suppress(Refusal):
                armed_jobs = (await client.list_jobs(state="armed")).jobs
                if armed_jobs:
                    await sleep_ns(self._fleet.clock, self._draw.randint(*_GO_NS))
                    await client.go_job(armed_jobs[0].id)


class FlightActs:
    """Acts on flights from now on, once on each, if one of `stages` has some; in vain where a fault has ended one."""

    def __init__(self, fleet: VirtualFleet, seed: int, stages: Collection[Stage]) -> None:
        self._fleet = fleet
        self._draw = Random(seed)
        self._tasks = TaskOwner()
        if "flying" in stages:
            self._tasks.spawn(self._run())

    def end(self) -> None:
        """Look for flights no more."""
        self._tasks.cancel_all()

    async def _run(self) -> None:
        client, seen_jobs = self._fleet.make_client("flyer"), set[str]()
        while True:
            await sleep_ns(self._fleet.clock, _LOOK_NS)
            with suppress(Refusal):
                jobs = [entry.id for entry in (await client.list_jobs(state="running", name=FLIGHT_JOB)).jobs]
                for job_id in (job_id for job_id in jobs if job_id not in seen_jobs):
                    seen_jobs.add(job_id)
                    await self._act_on(client, job_id)

    async def _act_on(self, client: Tutti, job_id: str) -> None:
        """Do one thing with a flight. Raises `Refusal`."""
        act, percent = self._draw.choice(_ACTS), self._draw.choice(_PERCENTS)
        await sleep_ns(self._fleet.clock, self._draw.randint(*_ACT_NS))
        if act == "override":
            await client.override_job(job_id, percent)
            await sleep_ns(self._fleet.clock, self._draw.randint(*_OVERRIDE_NS))
            await client.override_job(job_id, 100)
        elif act != "none":
            await client.pause_job(job_id, now=act == "pause-now")
            await self._resume(client, job_id)

    async def _resume(self, client: Tutti, job_id: str) -> None:
        """Resume a job some time after it has paused, also if the coordinator is away meanwhile; end if the job has."""
        while (state := self._find_state(job_id)) not in FINISHED_STATES:
            await sleep_ns(self._fleet.clock, self._draw.randint(*_PAUSE_NS) if state == "paused" else _LOOK_NS)
            if state == "paused":
                with suppress(Refusal):
                    await client.resume_job(job_id)
                    return

    def _find_state(self, job_id: str) -> str:
        row = self._fleet.journal.load_record(job_id)
        return "failed" if row is None else row.state
