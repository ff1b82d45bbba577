"""The fleets of `tutti bench steps`, how far their axes move, and what is asked of the gap."""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, NamedTuple

from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.examples import find_example
from orchestrator.runtime.simulated_fleets import make_cia402, make_ppsmc, make_shrc203, make_smc30, make_smc4000

SCAN_POINTS = 1000
SCAN_MS = 100.0


class AskedGap(NamedTuple):
    """The largest gap that is asked for: the largest of the bounds that are given. script: times the script's gap.
    limit_ms: a fixed one. wire, wire_more_ms: times the wire's own sum, and added to it."""

    script: float | None = None
    limit_ms: float | None = None
    wire: float | None = None
    wire_more_ms: float = 0.0

    def bound_ms(self, script_ms: float, wire_ms: float) -> float:
        """The bound of a row, ms. script_ms: the script's gap; wire_ms: the wire's own sum."""
        bounds = (
            None if self.script is None else self.script * script_ms,
            self.limit_ms,
            None if self.wire is None else self.wire * wire_ms + self.wire_more_ms,
        )
        return max(bound for bound in bounds if bound is not None)

    def __str__(self) -> str:
        parts = (
            None if self.script is None else f"{self.script:g} x script",
            None if self.limit_ms is None else f"{self.limit_ms:g} ms",
            None
            if self.wire is None
            else (f"{self.wire:g} x wire" if self.wire != 1 else "wire")
            + (f" + {self.wire_more_ms:g} ms" if self.wire_more_ms else ""),
        )
        return " or ".join(part for part in parts if part is not None)


class StepsFleet(NamedTuple):
    """A fleet of the benchmark. counts: how far each axis moves to and fro, one axis of each controller."""

    name: str
    fleet: Fleet
    counts: Mapping[str, int]
    asked: AskedGap


def list_fleets() -> list[StepsFleet]:
    """Return the fleets of the benchmark."""
    quick = AskedGap(script=1.5)
    slow = AskedGap(script=2.0, wire=1.0, wire_more_ms=3.0)
    serial = AskedGap(script=1.5, wire=1.0, wire_more_ms=3.0)
    demo = load_fleet(find_example("demo.fleet.yaml"))
    return [
        *(_make_fleet(f"1 SMC-4000, {ms} ms", [make_smc4000(0)], ms, quick) for ms in (28, 90, 400)),
        *(_make_fleet(f"1 SHRC-203, {ms} ms", [make_shrc203(0)], ms, serial) for ms in (100, 400)),
        _make_fleet("1 SMC30, 400 ms", [make_smc30(0, 1)], 400, slow),
        _make_fleet("1 pp-electronic SMC, 140 ms", [make_ppsmc(0)], 140, slow),
        _make_fleet("1 CiA 402 drive, 400 ms", [make_cia402(1)], 400, quick),
        _make_fleet("8 SMC-4000, 90 ms", [make_smc4000(k) for k in range(8)], 90, AskedGap(limit_ms=8.0)),
        StepsFleet(
            "SMC-4000 + SHRC-203, 220 ms",
            demo,
            {axis: find_counts(demo.axis(axis), 220) for axis in ("gantry.x", "stage.u")},
            AskedGap(limit_ms=25.0, wire=1.0),
        ),
        _make_fleet(
            "7 SMC30 on one bus, 400 ms", [make_smc30(0, number) for number in range(1, 8)], 400, AskedGap(wire=1.3)
        ),
    ]


def make_scan_fleet() -> StepsFleet:
    """Return the SMC30 of the scan; its counts are the distance of two points."""
    return _make_fleet("1 SMC30, scan", [make_smc30(0, 1)], SCAN_MS, AskedGap(script=1.2))


def _make_fleet(name: str, controllers: list[dict[str, Any]], move_ms: float, asked: AskedGap) -> StepsFleet:
    named_controllers = {f"c{number}": controller for number, controller in enumerate(controllers)}
    fleet = Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "steps", "controllers": named_controllers})
    counts = {f"{name}.x": find_counts(fleet.axis(f"{name}.x"), move_ms) for name in named_controllers}
    return StepsFleet(name, fleet, counts, asked)


def find_counts(axis: Axis, move_ms: float) -> int:
    """The distance that the axis needs `move_ms` for at its limits, in whole counts.

    By velocity v and acceleration a: v (t - v / a) where there is time to reach v, a t² / 4 where there is not. The
    start rate is left out, so that a stepper is some milliseconds sooner."""
    velocity, acceleration, move_s = axis.limits.velocity, axis.limits.acceleration, move_ms / 1000
    if move_s >= 2 * velocity / acceleration:
        distance = velocity * (move_s - velocity / acceleration)
    else:
        distance = acceleration * move_s**2 / 4
    return abs(axis.to_counts(Fraction(distance)))
