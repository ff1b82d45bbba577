"""Targets after gearing, on both simulated Yaskawa controllers: they are absolute (SMC-4000: L8210; SMC-2000: L10760)."""

from typing import Any

import pytest

from orchestrator.clock.queue import EventQueue
from sim.yaskawa import SMC2000, SMC4000

MASTERS = [(SMC4000, "tcp", "GAY=X"), (SMC2000, "serial", "GA X")]


class Bench:
    """A controller whose motors are on and whose axis Y has followed X by 10000 counts."""

    def __init__(self, simulator: Any, port: str, master: str, **options: object) -> None:
        self.clock, self.answers = EventQueue(), bytearray()
        self.unit = simulator.build_controller(self.clock, options)
        self.line = self.unit.connect(port, self.answers.extend, lambda: None)
        self.ask("EO 0", "SHXY", master, "GRY=0.5", "PRX=20000", "BGX")
        self.rest()
        self.ask("GRY=0")

    def ask(self, *commands: str) -> str:
        for command in commands:
            self.answers.clear()
            self.line.receive_bytes(command.encode() + b"\r")
            self.clock.run_until_ns(self.clock.now_ns() + 1)
        return self.answers.decode("latin-1")

    def rest(self) -> None:
        while not self.unit.at_rest():
            assert self.clock.make_next_call()

    def number(self, operand: str) -> float:
        return float(self.ask(f"MG {operand}").split()[0])


@pytest.mark.parametrize(("simulator", "port", "master"), MASTERS, ids=["smc4000", "smc2000"])
def test_an_absolute_target_after_gearing_is_absolute(simulator: Any, port: str, master: str):
    bench = Bench(simulator, port, master)
    assert [bench.number(each) for each in ("_TPY", "_RPY", "_PAY")] == [10_000, 10_000, 10_000]
    bench.ask("PAY=5000", "BGY")
    assert bench.number("_PRY") == -5000
    bench.rest()
    assert bench.number("_TPY") == 5000
    bench.ask("PRY=700", "BGY")
    bench.rest()
    assert bench.number("_TPY") == 5700


@pytest.mark.parametrize(("simulator", "port", "master"), MASTERS, ids=["smc4000", "smc2000"])
def test_an_absolute_target_of_a_follower_is_absolute_where_it_begins(simulator: Any, port: str, master: str):
    bench = Bench(simulator, port, master)
    bench.ask("GRY=1", "PAY=4000", "BGY")
    bench.rest()
    assert bench.number("_TPY") == 4000
    bench.ask("PRX=100", "BGX")
    bench.rest()
    assert bench.number("_TPY") == 4100


@pytest.mark.parametrize(("simulator", "port", "master"), MASTERS, ids=["smc4000", "smc2000"])
def test_a_move_against_a_soft_limit_is_refused_by_its_absolute_target(simulator: Any, port: str, master: str):
    bench = Bench(simulator, port, master)
    bench.ask("FLY=9000")
    bench.ask("PAY=11000")
    assert bench.ask("BGY") == "?"
    bench.ask("PAY=8000")
    assert bench.ask("BGY") == ":"
    bench.rest()
    assert bench.number("_TPY") == 8000


@pytest.mark.parametrize(("simulator", "port", "master"), MASTERS, ids=["smc4000", "smc2000"])
def test_homing_after_gearing_finds_the_switch_where_it_is(simulator: Any, port: str, master: str):
    bench = Bench(simulator, port, master, home_edge={"Y": 12_000})
    bench.ask("SPY=20000", "FEY", "BGY")
    bench.rest()
    # It passes the edge by the ramp: v²/2a = 781 counts.
    assert 12_000 <= bench.unit.position("Y") <= 12_900


def test_gears_and_ratios_are_burned_and_the_gantry_mode_is_not():
    bench = Bench(SMC4000, "tcp", "GAY=X")
    bench.ask("GRY=0.5", "GMY=1", "BN", "RS")
    assert (bench.number("_GRY"), bench.number("_GMY")) == (0.5, 0)
    bench.ask("SHXY", "PRX=1000", "BGX")
    bench.rest()
    assert bench.number("_TPY") == 500
