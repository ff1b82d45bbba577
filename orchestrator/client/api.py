"""Submit jobs, watch them, look at the fleet, stop it. The command line is built on this.

async with Tutti("tcp/127.0.0.1:7447") as tutti:
    job = await tutti.submit(load_job(Path("demo.job.yaml")))
    async for event in job.events():
        print(event)
    report = await job.result()
"""

import asyncio
import uuid
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any, Self, TypeVar

from orchestrator.bus.base import Bus, NoReply, RequestRefused, RequestTimeout, Sample
from orchestrator.bus.estop import put_estop
from orchestrator.bus.fleets import find_fleets
from orchestrator.bus.keys import Keys
from orchestrator.client.jobs import SubmittedJob
from orchestrator.model.base import Model
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import UNKNOWN_ACTOR, Job
from orchestrator.model.messages import Raw, RawReply, Refusal, Reply, Request, Reset, Stop, TraceReply
from orchestrator.model.queue import Terms
from orchestrator.model.report import ENDED, JobReport, JobState, Lease, Progress, QueueEntry, QueueState, StepRecording
from orchestrator.model.service import (
    Again,
    AgainReply,
    GiveBack,
    JobRef,
    JobRefs,
    JobShown,
    ListJobs,
    MoveJob,
    PauseJob,
    Prune,
    Pruned,
    Recorded,
    RecordingRef,
    Reload,
    Reloaded,
    StopFleet,
    Submit,
    Submitted,
    Take,
    Taken,
    WireFound,
    WiringChecked,
)
from orchestrator.model.state import ControllerState, Info

if TYPE_CHECKING:
    from orchestrator.client.manual import Hand

M = TypeVar("M", bound=Model)

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
ANSWER_S = 3.0
STOP_LOOK_S = 0.3  # for seeing whom to stop: an adapter that takes longer to say that it is there hangs
DRY_RUN_S = 30.0
RELOAD_S = 60.0
PRUNE_S = 60.0
WIRING_S = 60.0


class Refused(Exception):
    """The service says no; `refusal` says why and what to do."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.text)
        self.refusal = refusal


class Tutti:
    """A connection to one fleet; use it as a context.

    connect: the router, e.g. `tcp/127.0.0.1:7447`, or a bus. fleet: without, the only one there. actor: who asks, for
    journals and logs.
    """

    def __init__(
        self,
        connect: str | Bus = DEFAULT_ENDPOINT,
        fleet: str | None = None,
        actor: str = "api",
        new_id: Callable[[], str] = lambda: uuid.uuid4().hex,
    ) -> None:
        self._endpoint = connect if isinstance(connect, str) else ""
        self._bus = None if isinstance(connect, str) else connect
        self._keys = None if fleet is None else Keys(fleet)
        self.actor = actor
        self.new_id = new_id

    async def open(self) -> Self:
        """Connect, which entering the context does. Raises `RouterUnreachable`, or `Refused` with code `no-fleet` or
        `which-fleet`."""
        from orchestrator.bus.zenoh.bus import open_bus

        if self._bus is None:
            self._bus = await open_bus(self._endpoint)
        if self._keys is None:
            try:
                self._keys = Keys(await find_fleet(self._bus))
            except BaseException:
                await self.close()
                raise
        return self

    @property
    def bus(self) -> Bus:
        if self._bus is None:
            raise RuntimeError("not connected; use it as `async with Tutti(…) as tutti:`")
        return self._bus

    @property
    def keys(self) -> Keys:
        if self._keys is None:
            raise RuntimeError("not connected; use it as `async with Tutti(…) as tutti:`")
        return self._keys

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Leave. Safe to call twice."""
        bus, self._bus = self._bus, None
        if bus is not None:
            await bus.close()

    # Jobs

    async def submit(self, job: Job, client_key: str | None = None, terms: Terms | None = None) -> SubmittedJob:
        """Submit a job: its id, once it is safe in the journal. A job without an actor gets ours. Raises `Refused`.

        The same `client_key` is the same job, however often it is submitted.

        terms: its place in the queue: priority, repeats, after which job or at what time it begins.
        """
        return self.job((await self.enqueue(job, client_key, terms)).id)

    def job(self, job_id: str) -> SubmittedJob:
        """A job by its id, to follow it."""
        return SubmittedJob(job_id, self)

    async def enqueue(self, job: Job, client_key: str | None = None, terms: Terms | None = None) -> QueueEntry:
        """Submit a job, and see how it stands in the queue. Raises `Refused`."""
        if job.actor == UNKNOWN_ACTOR:
            job = job.model_copy(update={"actor": self.actor})
        request = Submit(**self.fields(), job=job, client_key=client_key or self.new_id(), terms=terms or Terms())
        entry = (await self.service("submit", request, Submitted)).entry
        assert entry is not None
        return entry

    async def dry_run(self, job: Job) -> dict[str, Any]:
        """What each motion step would take, from where the fleet stands now. Raises `Refused`."""
        request = Submit(**self.fields(), job=job, client_key=self.new_id(), dry_run=True)
        return (await self.service("submit", request, Submitted, DRY_RUN_S)).dry_run or {}

    async def jobs(
        self, limit: int = 50, state: JobState | None = None, name: str = "", since: str | None = None
    ) -> QueueState:
        """The newest jobs, newest first: in `state`, with `name` in their name, submitted at `since` (RFC 3339) or
        later. `total` says how many there are. Raises `Refused`."""
        request = ListJobs(**self.fields(), limit=limit, state=state, name=name, since=since)
        return await self._ask_service("list", request, QueueState, ANSWER_S)

    async def show(self, job_id: str) -> JobShown:
        """Everything the journal has of a job. Raises `Refused`."""
        return await self.service("show", JobRef(**self.fields(), job_id=job_id), JobShown)

    async def show_when_there(self, job_id: str, poll_s: float = 0.5) -> JobShown:
        """The same, waiting for a coordinator that is away. Raises `Refused` for a job that does not exist."""
        while True:
            try:
                return await self.show(job_id)
            except Refused as error:
                if error.refusal.code not in ("no-coordinator", "no-answer"):
                    raise
            await asyncio.sleep(poll_s)

    async def recording(self, job_id: str, step: int) -> StepRecording | None:
        """What a motion step was planned to do and what polls have shown of it; None if nothing is kept of it."""
        request = RecordingRef(**self.fields(), job_id=job_id, step=step)
        return (await self.service("recording", request, Recorded)).recording

    async def cancel(self, job_id: str) -> None:
        """Cancel a job, queued or running. Raises `Refused`."""
        await self.service("cancel", JobRef(**self.fields(), job_id=job_id), Reply)

    async def hold(self, *job_ids: str) -> None:
        """Keep queued jobs from beginning. Raises `Refused`: code `not-queued`."""
        await self.service("hold", JobRefs(**self.fields(), job_ids=list(job_ids)), Reply)

    async def release(self, *job_ids: str) -> None:
        """Let held jobs begin when it is their turn; without any, all that are held. Raises `Refused`."""
        await self.service("release-job", JobRefs(**self.fields(), job_ids=list(job_ids)), Reply)

    async def move(self, job_id: str, before: str) -> None:
        """Put a queued job before another one, with that one's priority. Raises `Refused`: code `not-queued`."""
        await self.service("move", MoveJob(**self.fields(), job_id=job_id, before=before), Reply)

    async def pause(self, job_id: str, now: bool = False) -> None:
        """Hold a running job when its present step has ended; it keeps its axes. now: inside a motion step; its axes
        brake together, and `resume` goes on from where they stand. Raises `Refused`: `not-running`."""
        await self.service("pause", PauseJob(**self.fields(), job_id=job_id, now=now), Reply)

    async def resume(self, job_id: str) -> None:
        """Go on with a paused job. Raises `Refused`: codes `not-running`, `not-paused`."""
        await self.service("resume", JobRef(**self.fields(), job_id=job_id), Reply)

    async def again(
        self,
        job_id: str,
        from_step: int = 0,
        dry_run: bool = False,
        terms: Terms | None = None,
        client_key: str | None = None,
    ) -> AgainReply:
        """Do an ended job again, from a step on: a new job. With `dry_run` only what remains of it, and where its axes
        stand now. Raises `Refused`: codes `not-ended`, `no-step`."""
        request = Again(
            **self.fields(),
            job_id=job_id,
            from_step=from_step,
            dry_run=dry_run,
            terms=terms,
            client_key=client_key or self.new_id(),
        )
        return await self.service("retry", request, AgainReply)

    async def prune(self, older_s: float, keep: int) -> int:
        """Forget ended jobs that were submitted more than `older_s` ago, but none of the newest `keep`; how many."""
        return (await self.service("prune", Prune(**self.fields(), older_s=older_s, keep=keep), Pruned, PRUNE_S)).jobs

    async def wait(
        self, job_id: str, on_progress: Callable[[Progress], None] | None = None, poll_s: float = 1.0
    ) -> JobReport:
        """Wait for a job's end and give its report. Progress comes from the bus; the journal has the last word.

        Raises `Refused` for a job that does not exist. A coordinator that is away meanwhile is waited for.
        """
        changed = asyncio.Event()

        def take(sample: Sample) -> None:
            progress = Progress.model_validate_json(sample.payload)
            if on_progress is not None:
                on_progress(progress)
            if progress.state in ENDED:
                changed.set()

        subscription = await self.bus.subscribe(self.keys.job_state(job_id), take)
        try:
            while True:
                report = (await self.show_when_there(job_id, poll_s)).report
                if report is not None:
                    return report
                changed.clear()
                try:
                    async with asyncio.timeout(poll_s):
                        await changed.wait()
                except TimeoutError:
                    continue
        finally:
            await subscription.undeclare()

    # The fleet

    async def status(self, timeout_s: float = ANSWER_S) -> dict[str, ControllerState]:
        """The state of every controller that has an adapter now, by id. One that hangs costs `timeout_s`."""
        replies = await self.bus.request_all(self.keys.state(), b"", timeout_s)
        states = [ControllerState.model_validate_json(payload) for payload in replies.values()]
        return {state.controller: state for state in sorted(states, key=lambda each: each.controller)}

    async def stop(self, mode: str = "decelerate") -> dict[str, Refusal | None]:
        """Stop every controller, directly, and the running jobs, and hold what is queued. What each controller
        answered, by id."""
        fleet = StopFleet(**self.fields(), mode="abort" if mode == "abort" else "decelerate")
        request = Stop(**self.fields(), mode=fleet.mode)
        # The coordinator knows all controllers, and the job; who is there is asked meanwhile, for it may be away.
        service = asyncio.ensure_future(self.service("stop", fleet, Reply))
        controllers = list(await self.status(STOP_LOOK_S))
        stops = [self.command(controller, "stop", request, Reply) for controller in controllers]
        *replies, _ = await asyncio.gather(*stops, service, return_exceptions=True)
        return {
            controller: reply.refusal if isinstance(reply, Refused) else None
            for controller, reply in zip(controllers, replies, strict=True)
        }

    async def estop(self, reason: str = "", timeout_s: float = 2.0) -> dict[str, bool]:
        """Put an e-stop, and say which controllers show its latch within `timeout_s`."""
        put_estop(self.bus, self.keys.fleet, f"{self.actor}-{self.new_id()[:8]}", self.actor, reason)
        return await self.latched(timeout_s)

    async def latched(self, timeout_s: float = 2.0) -> dict[str, bool]:
        """Which controllers show that they are latched by an e-stop: as soon as all do, or after `timeout_s`."""
        latched: dict[str, bool] = {}
        try:
            async with asyncio.timeout(timeout_s):
                while not latched or not all(latched.values()):
                    latched = {name: state.estop is not None for name, state in (await self.status()).items()}
        except TimeoutError:
            pass
        return latched

    async def reset(self, event: str | None = None) -> dict[str, Refusal | None]:
        """Release the e-stop latch named `event` (None: any) on every controller, and clear what can be cleared.

        All are asked first whether it is safe; if one says no, none is released. What each answered, by id.
        """
        controllers = list(await self.status())
        answers: dict[str, Refusal | None] = {}
        for check in (True, False):
            asked = [
                self.command(controller, "reset", Reset(**self.fields(), event=event, check=check), Reply)
                for controller in controllers
            ]
            replies = await asyncio.gather(*asked, return_exceptions=True)
            answers = {
                controller: reply.refusal if isinstance(reply, Refused) else None
                for controller, reply in zip(controllers, replies, strict=True)
            }
            if any(answers.values()):
                break
        return answers

    async def reload(self, fleet: Fleet) -> list[str]:
        """Give the running fleet another fleet file; the controllers that have changed. Raises `Refused`."""
        request = Reload(**self.fields(), configuration=fleet.to_plain())
        return (await self.service("reload", request, Reloaded, RELOAD_S)).changed

    async def check_wiring(self) -> list[WireFound]:
        """Whether each wire of the fleet file is there; nothing moves. Raises `Refused` while wired axes are in use."""
        return (await self.service("check-wiring", Request(**self.fields()), WiringChecked, WIRING_S)).wires

    async def info(self, controller: str) -> Info:
        """Who a controller is, what it can do, and the configuration that its adapter holds. Raises `Refused`."""
        request = Request(**self.fields())
        return await self._ask(self.keys.info(controller), request, Info, ANSWER_S, _absent(controller))

    async def axis_config(self, axis: str) -> dict[str, Any]:
        """The configuration of `controller.axis` as its adapter holds it. Raises `Refused`."""
        controller, _, name = axis.partition(".")
        info = await self.info(controller)
        if name not in info.axes:
            text = f"{controller} has no axis {name!r}; its axes are: {', '.join(info.axes)}"
            raise Refused(Refusal(code="unknown-axis", text=text, remedy="see `tutti axis ls`"))
        return info.axes[name]

    async def raw(self, controller: str, command: str, i_know: bool) -> str:
        """Send a line in the controller's own language, with all its axes in hand meanwhile. Raises `Refused`."""
        async with self.by_hand([controller], what="raw command") as hand:
            request = Raw(**self.fields(), holder=hand.holder, command=command, i_know=i_know)
            return (await self.command(controller, "raw", request, RawReply)).reply

    async def trace(self, controller: str) -> TraceReply:
        """The last minute of bytes on a controller's link. Raises `Refused`."""
        return await self.command(controller, "trace", Request(**self.fields()), TraceReply)

    @asynccontextmanager
    async def samples(self, *expressions: str) -> AsyncGenerator["asyncio.Queue[Sample]"]:
        """A queue that gets every sample on the given key expressions while the context lasts."""
        queue: asyncio.Queue[Sample] = asyncio.Queue()
        declared = [await self.bus.subscribe(expression, queue.put_nowait) for expression in expressions]
        try:
            yield queue
        finally:
            for each in declared:
                await each.undeclare()

    # By hand

    def by_hand(self, axes: Sequence[str], what: str = "by hand", ttl_s: float = 3.0) -> "Hand":
        """Axes (groups, controllers) in hand while the context lasts: nothing else moves them, and they can be jogged.

        async with tutti.by_hand(["gantry.x"], what="alignment") as hand:
            await hand.jog({"gantry.x": 5.0})

        what: shown to those who are refused meanwhile. ttl_s: how long the axes stay taken when this process dies.
        Entering raises `Refused`: code `leased` while somebody else has one of them, `permit` while one is missing.
        """
        from orchestrator.client.manual import Hand

        return Hand(self, axes, what, ttl_s)

    async def reserve(self, axes: Sequence[str], seconds: float, what: str = "manual work") -> tuple[list[str], str]:
        """Take axes (groups, controllers) for work at the machine, for so long or until `give_back`: jobs that need
        them wait, other people are refused. All that are taken, and their holder. Raises `Refused`: code `leased`."""
        holder = f"hand-{self.new_id()}"
        request = Take(**self.fields(), axes=list(axes), holder=holder, what=what, ttl_s=seconds, reserve=True)
        return (await self.service("take", request, Taken)).axes, holder

    async def give_back(self, holder: str) -> None:
        """Give back all that `holder` has in hand. Raises `Refused`."""
        await self.service("release", GiveBack(**self.fields(), holder=holder), Reply)

    async def leases(self) -> list[Lease]:
        """Who has the axes of each controller now; of several, one."""
        replies = await self.bus.request_all(self.keys.leases, b"", ANSWER_S)
        found = [Lease.model_validate_json(payload) for payload in replies.values()]
        return sorted(found, key=lambda each: each.controller)

    # What the other modules of this package ask with

    def fields(self) -> dict[str, Any]:
        """What every request carries."""
        return {"request_id": self.new_id(), "actor": self.actor}

    async def service(self, verb: str, request: Request, reply: type[M], timeout_s: float = ANSWER_S) -> M:
        """Ask the reigning coordinator. Raises `Refused`."""
        return _accepted(await self._ask_service(verb, request, reply, timeout_s))

    async def command(
        self, controller: str, verb: str, request: Request, reply: type[M], timeout_s: float = ANSWER_S
    ) -> M:
        """Ask a controller's adapter. Raises `Refused`; adapters know their axes by their own names only, so the
        controller's is put before what they say."""
        key = self.keys.cmd(controller, verb)
        try:
            return _accepted(await self._ask(key, request, reply, timeout_s, _absent(controller)))
        except Refused as error:
            said = error.refusal
            if said.member != controller or controller in said.text:
                raise
            raise Refused(said.model_copy(update={"text": f"{controller}: {said.text}"})) from None

    # Inside

    async def _ask_service(self, verb: str, request: Request, reply: type[M], timeout_s: float) -> M:
        absent = Refusal(
            code="no-coordinator",
            text=f"no coordinator reigns in fleet {self.keys.fleet}",
            remedy="start one: `tutti up FLEET`",
        )
        return await self._ask(self.keys.svc(verb), request, reply, timeout_s, absent)

    async def _ask(self, key: str, request: Request, reply: type[M], timeout_s: float, absent: Refusal) -> M:
        try:
            return reply.model_validate_json(await self.bus.request(key, request.to_json(), timeout_s))
        except NoReply:
            raise Refused(absent) from None
        except RequestTimeout as error:
            raise Refused(Refusal(code="no-answer", text=str(error), remedy="is that process hung?")) from None
        except RequestRefused as error:
            raise Refused(Refusal(code="bad-request", text=str(error))) from None


async def find_fleet(bus: Bus) -> str:
    """The only fleet on the bus. Raises `Refused`."""
    fleets = await find_fleets(bus)
    if len(fleets) == 1:
        return fleets[0]
    if not fleets:
        raise Refused(Refusal(code="no-fleet", text="no fleet is on this bus", remedy="start one: `tutti up FLEET`"))
    text = f"several fleets are on this bus: {', '.join(fleets)}"
    raise Refused(Refusal(code="which-fleet", text=text, remedy="choose one with --fleet"))


def _accepted(reply: M) -> M:
    if isinstance(reply, Reply) and reply.refused is not None:
        raise Refused(reply.refused)
    return reply


def _absent(controller: str) -> Refusal:
    return Refusal(
        code="absent",
        text=f"no adapter answers for controller {controller}",
        remedy="see `tutti status` for those that are there",
        member=controller,
    )
