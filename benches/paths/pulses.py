"""Pulses on the way of moves and along paths of an SMC-4000: complete coordinators in virtual time, judged by the true
edges at the terminal of its output."""

from random import Random
from typing import Any, NamedTuple

from orchestrator.bus.base import BusSample
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.recording import RecordedTriggers
from orchestrator.model.report import JobReport, TriggerRow
from orchestrator.runtime.simulated_fleets import DRIFT_PPM, WANDER_PPM, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

NAME, NUMBER = "gantry", 1
OUTPUT = f"{NAME}.lamp"
LIMITS = {"velocity": 200, "acceleration": 1000, "jerk": 20_000}
HISTORY_S = 60  # of polls before: the clock is known as well by then as it ever is
RADIUS = 40.0  # mm
LEAST_MS, MOST_MS = 15, 25  # between two pulses in time
LEAST_MM, MOST_MM = 1.5, 3.0  # between two in positions, at 50 mm/s


class PulsesTask(NamedTuple):
    """A fleet with crystals of its own, which pulses on moves and circles until there are `pulses` true edges or more.
    seed: of crystals, links, circles and pauses."""

    pulses: int
    seed: int


class PulsesRun(NamedTuple):
    """What happened. missed: edges without a row, and rows without evidence. outside_seen, outside_promise: edges that
    are not inside their interval by evidence, or by promise. widest_...: the widest interval by evidence. refused: why
    it did not run."""

    edges: int = 0
    missed: int = 0
    outside_seen: int = 0
    outside_promise: int = 0
    widest_move_ns: int = 0
    widest_path_ns: int = 0
    refused: str = ""


def run_pulses(task: PulsesTask) -> PulsesRun:
    """Pulse in virtual time."""
    return run_virtual(lambda clock: _run_pulses(clock, task))


def _make_fleet(draw: Random) -> Fleet:
    config = make_smc4000(0)
    axis = {**config["axes"]["x"], "limits": LIMITS}
    crystal = {
        "offset_s": draw.uniform(0, 600),
        "drift_ppm": draw.uniform(-DRIFT_PPM, DRIFT_PPM),
        "wander_ppm": WANDER_PPM,
    }
    controller: dict[str, Any] = {
        **config,
        "axes": {"x": axis, "y": {**axis, "motors": ["Y"]}},
        "outputs": {"lamp": {"number": NUMBER}},
        "simulate": {**config["simulate"], **crystal},
    }
    options: dict[str, Any] = {"home_edge": {"X": -2000, "Y": -2000}, "index_every": {"X": 200, "Y": 200}}
    controller["simulate"]["options"] = {**config["simulate"]["options"], **options}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "pulses", "controllers": {NAME: controller}})


class _PulsedSteps:
    """Runs steps with pulses, and compares their rows with the true edges."""

    def __init__(self, fleet: VirtualFleet) -> None:
        self._fleet = fleet
        self._client = fleet.make_client("pulses")
        self._rises: list[int] = []
        self._rows: list[TriggerRow] = []
        self.run = PulsesRun()
        fleet.controllers[NAME].on_output(self._note_edge)

    async def start(self) -> None:
        await self._client.bus.subscribe(self._client.keys.job_triggers(), self._note_rows)

    async def close(self) -> None:
        await self._client.close()

    def _note_edge(self, number: int, level: bool) -> None:  # noqa: FBT001 - as simulators call it
        if number == NUMBER and level:
            self._rises.append(self._fleet.clock.now_ns())

    def _note_rows(self, sample: BusSample) -> None:
        self._rows.extend(RecordedTriggers.read_message(sample.payload).rows)

    async def run_steps(self, steps: list[dict[str, Any]]) -> None:
        """Run steps, and judge their edges. Raises `Refusal`."""
        job = {"schema": "tutti.job/1", "name": "pulses", "max_start_skew": "20 ms", "steps": steps}
        report = await self._client.wait_for_job(await self._client.submit(Job.model_validate(job)), poll_s=0.5)
        await sleep_ns(self._fleet.clock, NS_PER_S)  # the rows are published after the report at the latest
        _require_done(report)
        self._judge(path=any(step["do"] == "path" for step in steps))

    def _judge(self, *, path: bool) -> None:
        origin_ns = next(iter(self._fleet.coordinators.values()))[1].leadership.scale.origin_host_ns
        rows, rises, run = self._rows, self._rises, self.run
        pairs = [(row, at_ns - origin_ns) for row, at_ns in zip(rows, rises, strict=False)]
        pulse_spans = [(row.seen, at_ns) for row, at_ns in pairs if row.seen is not None]
        widest_ns = max((span.latest_ns - span.earliest_ns for span, _ in pulse_spans), default=0)
        self.run = PulsesRun(
            edges=run.edges + len(rises),
            missed=run.missed + abs(len(rows) - len(rises)) + len(pairs) - len(pulse_spans),
            outside_seen=run.outside_seen
            + sum(not span.earliest_ns <= at_ns <= span.latest_ns for span, at_ns in pulse_spans),
            outside_promise=run.outside_promise
            + sum(not row.earliest_ns <= at_ns <= row.latest_ns for row, at_ns in pairs),
            widest_move_ns=run.widest_move_ns if path else max(run.widest_move_ns, widest_ns),
            widest_path_ns=max(run.widest_path_ns, widest_ns) if path else run.widest_path_ns,
        )
        rows.clear()
        rises.clear()


def _require_done(report: JobReport) -> None:
    refusal = next((step.refused for step in report.steps if step.refused is not None), None)
    if refusal is not None:
        raise Refusal(refusal.code, refusal.text, refusal.remedy)
    if report.state != "done":
        raise Refusal("failed", report.reason)


async def _run_pulses(clock: VirtualClock, task: PulsesTask) -> PulsesRun:
    draw = Random(f"pulses {task.seed}")
    fleet = VirtualFleet(_make_fleet(draw), clock, task.seed, guardian=False)
    await fleet.start()
    steps = _PulsedSteps(fleet)
    await steps.start()
    try:
        await steps.run_steps([{"do": "enable", "axes": [NAME]}, {"do": "home"}, _make_move(0, RADIUS)])
        await sleep_ns(clock, HISTORY_S * NS_PER_S + draw.randrange(NS_PER_S))
        while steps.run.edges < task.pulses:
            for step in _make_round(draw):
                await steps.run_steps([step])
                await sleep_ns(clock, draw.randrange(NS_PER_S))
    except Refusal as refusal:
        return steps.run._replace(refused=f"{refusal.code}: {refusal}")
    finally:
        await steps.close()
    return steps.run


def _make_round(draw: Random) -> list[dict[str, Any]]:
    """Two circles and two moves from the same place and back to it, each with pulses in time and in positions."""
    in_time = {"output": OUTPUT, "every": f"{draw.uniform(LEAST_MS, MOST_MS):.3f} ms"}
    on_way = {"output": OUTPUT, "every": f"{draw.uniform(LEAST_MM, MOST_MM):.3f} mm", "of": f"{NAME}.x"}
    distance = draw.uniform(2, 4) * RADIUS
    return [
        {**_make_circle(), "triggers": [in_time]},
        {**_make_circle(), "triggers": [{**on_way, "of": f"{NAME}.y"}]},
        {**_make_move(distance, RADIUS), "triggers": [on_way]},
        {**_make_move(0, RADIUS), "triggers": [in_time]},
    ]


def _make_move(x: float, y: float) -> dict[str, Any]:
    return {"do": "move", "to": {f"{NAME}.x": x, f"{NAME}.y": y}, "speed": 0.25}


def _make_circle() -> dict[str, Any]:
    target, centre = [0, RADIUS], [RADIUS, RADIUS]
    pieces = [{"piece": "arc", "to": target, "centre": centre}]
    axes = [f"{NAME}.x", f"{NAME}.y"]
    path = {"do": "path", "axes": axes, "start": target, "pieces": pieces}
    return {**path, "speed": "50 mm/s", "tolerance": "0.2 mm"}
