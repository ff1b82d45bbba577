"""Random feasible moves of steppers and of one drive: as planned, as lowered, and a seeded part of them as executed.

Rates are whole steps/s and ramps whole steps or milliseconds, so the accuracy depends on the mean rate of a move;
the figures are given for all moves together and by mean rate.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from adapters.contract import Driver
from adapters.shrc203.fleetaxes import axis_bounds
from adapters.shrc203.shapes.trapezoid import fit_trapezoid
from benches.makes.figures import BenchFigure, LoweringChoices, LoweringFigures, make_figure
from benches.makes.random_moves import LoweredMove, RandomMoves, make_executed_figures, run_random_moves
from orchestrator.link.memory import can_wire, serial_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.profile import Profile

CLASSES = (16.0, 33.0, 100.0, 1000.0)  # steps/s, of the mean rate, up to the fastest
ASKED_P99_MS = 0.2


@dataclass(frozen=True, slots=True)
class BenchedStepper:
    """A make and its controller of one axis `a`.

    quickest, acceleration: in steps/s (²).
    begins: prefix of those lines of `Lowered.commands` that are motions.
    port: of the simulated controller.
    alone: duration of the nearest move with a single command, in s, for comparison."""

    make: str
    link: Mapping[str, Any]
    options: Mapping[str, Any]
    simulate: Mapping[str, Any]
    axis: Mapping[str, Any]
    quickest: float
    acceleration: float
    begins: str
    port: str = "serial"
    alone: Callable[[Controller, Profile], float] | None = None


def _fit_one_trapezoid(config: Controller, profile: Profile) -> float:
    way = abs(profile.end_counts - profile.start_counts)
    shape = fit_trapezoid(way, profile.duration_s, profile.durations_s[0], axis_bounds(config.axes["a"]))
    assert shape is not None
    return shape.duration_s


STEPPERS = {
    stepper.make: stepper
    for stepper in (
        BenchedStepper(
            make="smc30",
            link={"kind": "serial", "device": "/dev/ttyS0", "baud": 9600, "data_bits": 7, "parity": "odd"},
            options={},
            simulate={"checksum": True},
            axis={
                "unit": "counts",
                "limits": {"velocity": 15_000, "acceleration": 200_000},
                "start_rate": {"min": 16, "max": 1000},
            },
            quickest=15_000.0,
            acceleration=200_000.0,
            begins="G",
        ),
        BenchedStepper(
            make="shrc203",
            link={"kind": "serial", "device": "/dev/ttyS0", "baud": 38400},
            options={"nm_per_pulse": 100},
            simulate={"divide": 20, "speed": [100, 20000, 100]},
            axis={
                "unit": "um",
                "scale": 10,
                "limits": {"velocity": 5_000, "acceleration": 50_000},
                "start_rate": {"min": 0.1, "max": 500},
            },
            quickest=50_000.0,
            acceleration=500_000.0,
            begins="MP",
            alone=_fit_one_trapezoid,
        ),
        BenchedStepper(
            make="cia402",
            link={"kind": "can", "interface": "socketcan", "channel": "can0", "address": 1},
            options={},
            simulate={},
            axis={"unit": "counts", "limits": {"velocity": 200_000, "acceleration": 1_000_000}},
            quickest=200_000.0,
            acceleration=1_000_000.0,
            begins="6040h",
            port="can",
        ),
    )
}


def bench_stepper(make: str, moves: int, seed: int) -> LoweringFigures:
    """Lower `moves` of one of `STEPPERS` and execute a part of them."""
    subject = STEPPERS[make]
    run = run_random_moves(_make_case(subject), moves, seed)
    figures = [
        make_figure("all, lowered-planned", [move.lowered_ms for move in run.moves], "ms", "p99<=0.2", _meets_p99),
        *make_executed_figures(run.moves, by_device=True),
    ]
    if subject.alone is not None:
        times_alone = [move.compared_ms for move in run.moves if move.compared_ms is not None]
        figures.append(make_figure("all, lowered-planned by one command", times_alone, "ms"))
    choices: list[LoweringChoices] = [LoweringChoices("refused", {"slower than the controller supports": run.refusals})]
    # Visible where one step of the cruise speed changes the duration by more than the longest ramp can compensate.
    times_within = [move.lowered_ms for move in run.moves if move.profile.duration_s < move.rate]
    if times_within:
        figures.append(make_figure("seconds < steps/s, lowered-planned", times_within, "ms", "p99<=0.2", _meets_p99))
    for low, high in pairwise((*CLASSES, subject.quickest)):
        of_class = [move for move in run.moves if low <= move.rate < high]
        name = f"{low:g}-{high:g}"
        if of_class:
            figures.append(make_figure(f"{name}, lowered-planned", [move.lowered_ms for move in of_class], "ms"))
        split = sum(_count_commands(subject, move) > 1 for move in of_class)
        choices.append(LoweringChoices(name, {"one command": len(of_class) - split, "several commands": split}))
    return LoweringFigures(make, moves, figures, choices)


def _make_case(subject: BenchedStepper) -> RandomMoves:
    config = Controller.model_validate(
        {
            "adapter": subject.make,
            "link": subject.link,
            # Durations are compared in the controller's own time: nothing has to be learned of its crystal.
            "options": {**subject.options, "clock_ppm": 0},
            "axes": {"a": {"motors": ["1"], **subject.axis}},
        }
    )
    find_single_s = subject.alone

    def compare_single(_: Driver, profile: Profile, __: float) -> float:
        assert find_single_s is not None
        return abs(find_single_s(config, profile) - profile.duration_s) * 1e3

    return RandomMoves(
        config=config,
        model=serial_wire(subject.link["baud"]) if "baud" in subject.link else can_wire(),
        port=subject.port,
        simulate=subject.simulate,
        quickest=subject.quickest,
        acceleration=subject.acceleration,
        steps_most=300_000,
        compare=None if find_single_s is None else compare_single,
    )


def _count_commands(subject: BenchedStepper, move: LoweredMove) -> int:
    return sum(line.startswith(subject.begins) for line in move.lowered.commands)


def _meets_p99(found: BenchFigure) -> bool:
    return found.p99 <= ASKED_P99_MS
