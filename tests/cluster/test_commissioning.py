"""A fleet file that states nothing about simulation runs simulated: its axes are homed and moved."""

import random
from fractions import Fraction
from typing import Any

import pytest
from cluster.worlds import EXAMPLES, changed, job, outcome, run_fleet
from unit.random_rounds import share_with_nightly

from adapters.host.makes import apply_make_defaults, find_controller_problems
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet, parse_file, read_document
from orchestrator.runtime.example_fleet import MakeCount, make_example_fleet
from orchestrator.runtime.simulated import find_simulation_problems, make_simulator_options
from orchestrator.runtime.virtual.fleet import VirtualFleet

LINKS: dict[str, dict[str, Any]] = {
    "smc4000": {"kind": "tcp", "host": "10.0.0.1", "port": 23},
    "smc2000": {"kind": "serial", "device": "/dev/ttyUSB0"},
    "shrc203": {"kind": "serial", "device": "/dev/ttyUSB1"},
    "ppsmc": {"kind": "tcp", "host": "10.0.0.2", "port": 1234},
    "smc30": {"kind": "serial", "device": "/dev/ttyUSB2", "address": 1},
    "cia402": {"kind": "can", "interface": "slcan", "channel": "/dev/ttyACM0", "address": 3},
}
MOTORS = {"smc4000": "XYZW", "smc2000": "XYZW", "shrc203": "123", "ppsmc": "1234", "smc30": "1", "cia402": "1"}
# Counts per unit, in mm: what such stages have.
SCALES = {
    "smc4000": ["1000", "500", "10000/3", "4096"],
    "smc2000": ["1000", "2000", "10000/3"],
    "shrc203": ["1000", "10000", "2000", "500"],
    "ppsmc": ["1000", "400", "200"],
    "smc30": ["400", "1000", "200"],
    "cia402": ["1000", "10000", "65536/5"],
}
SPEEDS = {"smc30": [1, 5, 8], "shrc203": [1, 5, 10]}


def draw_fleet(make: str, draw: random.Random) -> Fleet:
    axes: dict[str, Any] = {}
    for motor in MOTORS[make][: draw.randint(1, 3)]:
        speed = draw.choice(SPEEDS.get(make, [10, 50, 100]))
        sign, travel = draw.choice([1, 1, -1]), draw.choice([20, 50])
        # A search may end on a limit switch: its axis moves to the other side.
        positive = make in ("smc30", "ppsmc") and draw.choice([False, True])
        axes[f"a{motor.lower()}"] = {
            "motors": [motor],
            "unit": "mm",
            "scale": draw.choice(SCALES[make]),
            "sign": sign,
            "soft_limits": {"min": -travel, "max": 0} if positive else {"min": 0, "max": travel},
            "limits": {"velocity": speed, "acceleration": speed * draw.choice([2, 5])},
            "homing": {"direction": "positive" if positive else "negative"},
        }
    controller = {"adapter": make, "link": LINKS[make], "axes": axes}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "drawn", "controllers": {"it": controller}})


@pytest.mark.parametrize("seed", share_with_nightly(range(4), 2))
@pytest.mark.parametrize("make", LINKS)
def test_a_fleet_file_without_settings_of_the_simulation_runs(make: str, seed: int) -> None:
    fleet = apply_make_defaults(draw_fleet(make, random.Random(f"{make} {seed}")))
    assert find_controller_problems("it", fleet.controllers["it"]) == []
    ends = {
        name: 3 if axis.homing.direction == "negative" else -3 for name, axis in fleet.controllers["it"].axes.items()
    }
    targets = ", ".join(f"it.{name}: {end}" for name, end in ends.items())
    steps = f"[{{do: enable, axes: [it]}}, {{do: home}}, {{do: move, to: {{{targets}}}, max_start_skew: 50 ms}}]"

    async def main(virtual: VirtualFleet) -> None:
        report = await outcome(virtual, job(steps))
        assert report.state == "done", report.reason
        (state,) = (await virtual.make_client().status()).values()
        assert all(abs(axis.position - ends[name]) < 0.01 for name, axis in state.axes.items())

    run_fleet(main, fleet)


def run_example(*makes: MakeCount) -> Fleet:
    """Home and move all axes of an example fleet, as the guide says."""
    text = make_example_fleet(makes, "example", "example.fleet.yaml")
    source = read_document(text, "example.fleet.yaml")
    fleet = apply_make_defaults(parse_file(source, Fleet))
    for name, config in fleet.controllers.items():
        assert find_controller_problems(name, config) == []
    everything = ", ".join(fleet.controllers)
    targets = ", ".join(f"{axis}: 5" for axis in fleet.axis_names)
    steps = (
        f"{{do: enable, axes: [{everything}]}}, {{do: home}}, {{do: move, to: {{{targets}}}, max_start_skew: 100 ms}}"
    )

    async def main(virtual: VirtualFleet) -> None:
        report = await outcome(virtual, job(f"[{steps}]"))
        assert report.state == "done", report.reason

    run_fleet(main, fleet)
    return fleet


def test_a_fleet_of_three_makes_runs_at_the_first_try() -> None:
    fleet = run_example(MakeCount("smc4000", 2), MakeCount("shrc203", 1), MakeCount("smc30", 3))
    assert list(fleet.controllers) == ["smc4000-1", "smc4000-2", "shrc203", "smc30-1", "smc30-2", "smc30-3"]


@pytest.mark.parametrize("make", LINKS)
def test_the_example_of_each_make_is_what_init_writes_and_runs(make: str) -> None:
    path = EXAMPLES / f"{make}.fleet.yaml"
    assert path.read_text(encoding="utf-8") == make_example_fleet([MakeCount(make, 1)], make, path.name)
    run_example(MakeCount(make, 1))


def test_what_the_file_states_about_the_simulation_has_precedence() -> None:
    plain = draw_fleet("shrc203", random.Random(1)).to_plain()
    plain["controllers"]["it"]["simulate"] = {"options": {"divide": 20}}
    assert "base_rate" not in make_simulator_options(Fleet.model_validate(plain).controllers["it"])
    plain["controllers"]["it"]["simulate"] = {"options": {"dvide": 20}}
    (problem,) = find_simulation_problems("it", Fleet.model_validate(plain).controllers["it"])
    assert problem.place == ("controllers", "it", "simulate", "options", "dvide")
    assert "did you mean divide?" in problem.text


def test_stages_of_one_controller_with_different_pulses() -> None:
    plain = draw_fleet("shrc203", random.Random(2)).to_plain()
    axis = next(iter(plain["controllers"]["it"]["axes"].values()))
    plain["controllers"]["it"]["axes"] = {
        f"a{motor}": {**axis, "motors": [motor], "scale": scale} for motor, scale in (("1", "1000"), ("2", "2500"))
    }
    options = make_simulator_options(Fleet.model_validate(plain).controllers["it"])
    lengths = {motor: Fraction(rate * 10, options["divide"]) for motor, rate in options["base_rate"].items()}
    assert lengths == {"1": 1000, "2": 400}


@pytest.mark.parametrize("make", ["smc4000", "galil"])
def test_a_simulator_finds_the_reference_of_motors_by_either_name(make: str) -> None:
    """A and X are one motor: its simulated home switch, and its true motions, were those of the other name only."""
    fleet = load_fleet(EXAMPLES / f"{make}.fleet.yaml")
    fleet = changed(fleet, **{make: {"axes": {"x": {"motors": ["A"]}}}})

    async def main(virtual: VirtualFleet) -> None:
        report = await outcome(
            virtual, job(f"[{{do: enable, axes: [{make}]}}, {{do: home}}, {{do: move, to: {{{make}.x: 5}}}}]")
        )
        assert report.state == "done", report.reason
        # The truth has the names of the fleet file.
        assert "A" in {motion.axis for motion in virtual.controllers[make].commanded_motions}

    run_fleet(main, fleet)
