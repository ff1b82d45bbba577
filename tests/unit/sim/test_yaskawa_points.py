"""Times of the simulated Yaskawa controllers' digital inputs and outputs (SMC-4000: L407-L415, L482-L483, L3645,
L14243; SMC-2000: L3038, L7148)."""

from typing import Any

import pytest

from orchestrator.clock.queue import EventQueue
from sim.yaskawa import SMC2000, SMC4000

US = 1000
SPEED = 1_000_000
"""Counts/s of the axis whose position is captured: 25 us are 25 counts, one servo sample is 977."""


class Client:
    """A controller with a connection, and its outputs' terminals."""

    def __init__(self, simulator: Any, port: str, **options: object) -> None:
        self.clock, self._answers = EventQueue(), bytearray()
        self.unit = simulator.build_controller(self.clock, {"echo": False, **options})
        self.line = self.unit.connect(port, self._answers.extend, lambda: None)
        self.edges: list[tuple[int, int, bool]] = []
        self.unit.on_output(lambda number, on: self.edges.append((self.clock.now_ns() // US, number, on)))

    def ask(self, *commands: str) -> str:
        for command in commands:
            self._answers.clear()
            self.line.receive_bytes(command.encode() + b"\r")
        return self._answers.decode("latin-1")

    def wait(self, us: float) -> None:
        self.clock.run_until_ns(self.clock.now_ns() + round(us * US))

    def cruise(self) -> None:
        """Arm the latch of X while it moves at a constant speed."""
        self.ask("SHX", f"SPX={SPEED}", "ACX=60000000", "PRX=2000000000", "BGX", "AL X")
        self.wait(500_123)

    def pulse(self, us: float, number: int = 1) -> None:
        self.unit.set_input(number, level=False)
        self.wait(us)
        self.unit.set_input(number, level=True)
        self.wait(5000)

    def latched(self) -> bool:
        return self.ask("MG _ALX{F1.0}") == " 0\r\n:"

    def captured(self) -> int:
        return int(self.ask("MG _RLX{F10.0}").split("\r")[0])


def fine_position(client: Client, lag: int) -> float:
    """Where the encoder is now."""
    axis = client.unit.machine.motion.axes["X"]
    return axis.command_at(client.unit.machine.timebase.current_instant() - lag)


@pytest.mark.parametrize(("simulator", "port", "lag"), [(SMC4000, "tcp", 1), (SMC2000, "serial", 0)])
@pytest.mark.parametrize("phase_us", [0, 100, 333, 500, 976])
def test_a_position_is_captured_within_25_us_of_the_edge(simulator: Any, port: str, lag: int, phase_us: int) -> None:
    client = Client(simulator, port)
    client.cruise()
    client.wait(phase_us)
    before = fine_position(client, lag)
    client.pulse(100)
    assert client.latched()
    assert before <= client.captured() <= before + 25e-6 * SPEED + 1


def test_a_pulse_below_the_least_width_is_not_captured() -> None:
    client = Client(SMC4000, "tcp")
    client.cruise()
    client.pulse(8)
    assert not client.latched()
    client.pulse(10)
    assert client.latched()


def test_an_active_high_latch_takes_the_optocouplers_time() -> None:
    client = Client(SMC4000, "tcp")
    client.ask("CN ,,1")
    client.cruise()
    client.pulse(3000)
    client.ask("AL X")
    client.unit.set_input(1, level=False)
    client.wait(5000)
    before = fine_position(client, 1)
    client.unit.set_input(1, level=True)
    client.wait(1400)
    assert not client.latched()
    client.wait(200)
    assert client.captured() == pytest.approx(before + 1500e-6 * SPEED, abs=1)


def test_inputs_are_seen_after_their_optocouplers_time() -> None:
    client = Client(SMC4000, "tcp")
    client.unit.set_input(5, level=False)
    client.wait(499)
    assert client.ask("TI") == " 255\r\n:"
    client.wait(2)
    assert client.ask("TI") == " 239\r\n:"
    client.unit.set_input(5, level=True)
    client.wait(1499)
    assert client.ask("TI") == " 239\r\n:"
    client.wait(2)
    assert client.ask("TI") == " 255\r\n:"
    client.pulse(300, number=5)
    assert client.ask("TI") == " 255\r\n:"


def test_outputs_switch_after_their_optocouplers_time() -> None:
    client = Client(SMC4000, "tcp")
    client.ask("SB 2")
    assert client.ask("MG @OUT[2]{F1.0}") == " 1\r\n:" and not client.unit.output_level(2)
    client.wait(1000)
    assert client.edges == [(250, 2, True)] and client.unit.output_level(2)
    client.ask("CB 2")
    client.wait(1000)
    assert client.edges[1:] == [(1500, 2, False)]
    client.ask("SB 3")
    client.wait(100)
    client.ask("CB 3")
    client.wait(1000)
    assert len(client.edges) == 2


def test_the_smc2000_states_no_times() -> None:
    client = Client(SMC2000, "serial")
    client.unit.set_input(5, level=False)
    assert client.ask("TI") == " 239\r\n:"
    client.ask("SB 2")
    assert client.edges == [(0, 2, True)]


@pytest.mark.parametrize("delays", [{}, {"input_fall_us": 100, "input_rise_us": 200, "output_on_us": 10}])
def test_a_start_that_waits_for_an_input_begins_after_it(delays: dict[str, int]) -> None:
    client = Client(SMC4000, "tcp", **delays)
    client.ask("DL\r#A;SHX;PRX=1000;AI -1;BGX\rEN\r\x1a", "XQ #A")
    client.wait(10_000)
    client.unit.set_input(1, level=False)
    edge_ns = client.clock.now_ns()
    client.wait(10_000)
    (motion,) = client.unit.commanded_motions
    fall_ns = delays.get("input_fall_us", 500) * US
    assert fall_ns <= motion.start_ns - edge_ns <= fall_ns + 2 * 977 * US
