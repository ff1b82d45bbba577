"""Chains of prebuffered moves of an SHRC-203 at 38,400 baud: the duration of a move, and whether a chain runs dry.

In virtual time, checked against the simulated controller's ground truth. Between two completion lines the loader
must write the move after next; every move has its own speeds, so that its command line has the maximum length.
"""

from random import Random
from typing import NamedTuple

from adapters.contract import DriverSetup
from adapters.shrc203.chain_axis import ChainMove
from adapters.shrc203.driver import ShrcDriver
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.shapes.trapezoid import ShrcTrapezoid
from adapters.toolkit.firing import LoopTimedWriter
from benches.makes.drivers import connect_wire
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import Link, ReceivedBytes
from orchestrator.link.memory import serial_wire
from orchestrator.model.errors import TuttiError
from orchestrator.model.fleet import Controller
from sim.core.controller import FirmwareTiming
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

MODEL = "shrc203"
BAUD = 38400
HOST_DELAY_NS = NS_PER_MS  # from the arrival of a line to its handling
FIRMWARE = FirmwareTiming(decode_ns=1_000_000, spread_ns=1_000_000)
PPM = 50.0
# Axes, the moves' own duration (ms), and the target for a move with its hand-over.
CASES = ((("x",), 18, 20.0), (("x", "y", "z"), 33, 35.0))
MOTORS = {"x": "1", "y": "2", "z": "3"}
RAMPS_MS = range(2, 6)
START_SPEEDS = range(1000, 2000)  # pls/s
TOP_SPEEDS = range(10_000, 30_000)


class ChainFigures(NamedTuple):
    """The figures of one number of axes.

    move_ms: time from the first start to the last end, per move, of the slowest seed.
    ahead_ms: least time from the reply to a load to the next completion line, over all seeds.
    underruns: of all seeds."""

    axes: int
    moves: int
    seeds: int
    move_ms: float
    asked_ms: float
    ahead_ms: float
    underruns: int

    @property
    def met(self) -> bool:
        return self.move_ms <= self.asked_ms and self.underruns == 0


class _ChainResult(NamedTuple):
    move_ms: float
    ahead_ms: float
    underruns: int


class ChainBroke(TuttiError):
    """A chain did not run to its end, or not as commanded. The text names the chain and the reason."""


def bench_chain(moves: int, seeds: int) -> list[ChainFigures]:
    """Run a chain of `moves` for each number of axes and each seed. Raises `ChainBroke`."""
    figures: list[ChainFigures] = []
    for axes, duration_ms, asked_ms in CASES:
        runs = [_run_chain(axes, duration_ms, moves, seed) for seed in range(seeds)]
        figures.append(
            ChainFigures(
                axes=len(axes),
                moves=moves,
                seeds=seeds,
                move_ms=round(max(run.move_ms for run in runs), 3),
                asked_ms=asked_ms,
                ahead_ms=round(min(run.ahead_ms for run in runs), 3),
                underruns=sum(run.underruns for run in runs),
            )
        )
    return figures


def _run_chain(axes: tuple[str, ...], duration_ms: int, moves: int, seed: int) -> _ChainResult:
    return run_virtual(lambda clock: _measure_chain(clock, axes, duration_ms, moves, seed))


async def _measure_chain(
    clock: VirtualClock, axes: tuple[str, ...], duration_ms: int, moves: int, seed: int
) -> _ChainResult:
    draw = Random(seed)
    oscillator = Oscillator(0, draw.uniform(-PPM, PPM), 0.05, draw.getrandbits(32))
    unit = find_simulator(MODEL).build_controller(clock, {}, oscillator=oscillator, timing=FIRMWARE, seed=seed)
    wire = connect_wire(clock, serial_wire(BAUD), unit, unit.port_names[0], seed)

    async def open_slow_link() -> Link:
        return _SlowHost(await wire.open_link(), clock)

    setup = DriverSetup(
        controller="stage",
        config=_make_config(),
        options=ShrcOptions(),
        clock=clock,
        open_link=open_slow_link,
        timed_writer=LoopTimedWriter(clock),
    )
    driver = ShrcDriver(setup, ShrcOptions())
    await driver.connect()
    await driver.configure()
    chains = {axis: [_draw_move(draw, duration_ms) for _ in range(moves)] for axis in axes}
    report = await driver.run_chain(chains)
    await driver.close()
    for axis, chain in chains.items():
        motions = [motion for motion in unit.commanded_motions if motion.axis == MOTORS[axis]]
        ways = [
            None if motion.end_counts is None else round(motion.end_counts - motion.start_counts) for motion in motions
        ]
        if report.reason or ways != [move.distance for move in chain]:
            raise ChainBroke(f"seed {seed}, {len(axes)} axes, axis {axis}: {report.reason or 'other moves were made'}")
    ends = [motion.end_ns for motion in unit.commanded_motions if motion.end_ns is not None]
    took_ns = max(ends) - min(motion.start_ns for motion in unit.commanded_motions)
    return _ChainResult(took_ns / NS_PER_MS / moves, (report.least_ahead_ns or 0) / NS_PER_MS, len(report.underruns))


def _draw_move(draw: Random, duration_ms: int) -> ChainMove:
    """Draw a move that takes slightly less than `duration_ms`, with its own speeds."""
    s, f, r = draw.choice(START_SPEEDS), draw.choice(TOP_SPEEDS), draw.choice(RAMPS_MS)
    distance = round((s + f) * r / 1000 + f * (duration_ms - 2 * r) / 1000)
    while ShrcTrapezoid(distance, s, f, r).duration_s * 1000 > duration_ms:
        distance -= 1
    return ChainMove(draw.choice((1, -1)) * distance, ShrcTrapezoid(distance, s, f, r))


def _make_config() -> Controller:
    limits = {"velocity": 50, "acceleration": 100_000}
    start_rate = {"min": 1, "max": 5}
    axes = {
        name: {"motors": [motor], "unit": "um", "scale": 1000, "limits": limits, "start_rate": start_rate}
        for name, motor in MOTORS.items()
    }
    link = {"kind": "serial", "device": "/dev/null", "baud": BAUD}
    return Controller.model_validate({"adapter": MODEL, "link": link, "axes": axes})


class _SlowHost:
    """A link whose received bytes are delivered `HOST_DELAY_NS` late."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._clock = clock

    @property
    def endpoint(self) -> str:
        return self._link.endpoint

    @property
    def char_ns(self) -> int:
        return self._link.char_ns

    def write(self, data: bytes) -> int:
        return self._link.write(data)

    async def read(self) -> ReceivedBytes:
        received_bytes = await self._link.read()
        await sleep_until_ns(self._clock, max(self._clock.now_ns(), received_bytes.at_ns + HOST_DELAY_NS))
        return received_bytes

    def fileno(self) -> int:
        return self._link.fileno()

    def record_write(self, at_ns: int, data: bytes) -> None:
        self._link.record_write(at_ns, data)

    async def close(self) -> None:
        await self._link.close()
