"""Analogue inputs are set from outside, on every make; those without refuse."""

import pytest
from unit.sim.desk import Desk

from orchestrator.clock.queue import EventQueue
from sim.core.controller import DeviceSpec, FirmwareTiming
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator
from sim.link.world import EnvironmentRefused, change_environment
from sim.smc30 import SMC30
from sim.yaskawa import SMC2000


class Client:
    """A client at the first port of a controller."""

    def __init__(self, model: str, **options: object) -> None:
        self.clock, self.answers = EventQueue(), bytearray()
        self.unit = find_simulator(model).build_controller(self.clock, options)
        self.line = self.unit.connect(self.unit.port_names[0], self.answers.extend, lambda: None)

    def ask(self, text: str, wait_s: float = 0.1) -> str:
        self.answers.clear()
        self.line.receive_bytes(text.encode())
        self.clock.run_until_ns(self.clock.now_ns() + round(wait_s * 1e9))
        return self.answers.decode("latin-1")


def test_a_line_of_the_world_sets_volts() -> None:
    client = Client("smc2000", echo=False)
    for volts, shown in ((2.5, 2.5), (-10, -10.0), (12, 9.9987)):
        change_environment(client.unit, f'{{"analog": [7, {volts}]}}')
        assert float(client.ask("MG @AN[7]{F2.4}\r").split("\r")[0]) == pytest.approx(shown, abs=1e-4)
    indexer = Client("smc30")
    change_environment(indexer.unit, '{"analog": [2, 1.98]}')
    assert "1.98" in indexer.ask("VA2\r")


def test_a_program_that_waits_for_a_voltage_goes_on() -> None:
    client = Client("smc2000", echo=False, command_s=0.001)
    client.ask("DL\r#A;JP#A,@AN[1]<2\rSB1;EN\r\x1aXQ#A\r")
    change_environment(client.unit, '{"analog": [1, 1.9]}')
    client.ask("")
    assert not client.unit.output_level(1)
    change_environment(client.unit, '{"analog": [1, 2.1]}')
    client.ask("")
    assert client.unit.output_level(1)


def test_devices_that_share_a_line_are_set_one_by_one() -> None:
    clock = EventQueue()
    specs = [DeviceSpec(number, {}, Oscillator(), FirmwareTiming(), number) for number in (1, 2)]
    for simulator in (SMC2000, SMC30):
        _, units = simulator.build_shared(clock, specs)
        for number, unit in enumerate(units):
            change_environment(unit, f'{{"analog": [1, {number}.5]}}')
    chain = SMC2000.build_controller(clock, {"chain": [{"address": 0}, {"address": 3}]})
    chain.set_analog(301, 4.0)
    with pytest.raises(ValueError, match="analogue input 8"):
        chain.set_analog(308, 4.0)


@pytest.mark.parametrize("model", ["smc4000", "shrc203", "ppsmc", "cia402"])
def test_a_controller_without_analogue_inputs_refuses(model: str) -> None:
    with pytest.raises(EnvironmentRefused, match="no analogue input 1; this controller has no analogue inputs"):
        change_environment(find_simulator(model).build_controller(EventQueue(), {}), '{"analog": [1, 2.5]}')


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ('{"analog": [8, 1]}', "has 1 to 7"),
        ('{"analog": [0, 1]}', "analog.0"),
        ('{"analog": [1, "inf"]}', "analog.1"),
        ('{"analog": [1, 1e300]}', "analog.1"),
        ('{"analog": [1]}', "analog"),
    ],
)
def test_a_wrong_line_is_refused(line: str, named: str) -> None:
    with pytest.raises(EnvironmentRefused, match=named):
        change_environment(Client("smc2000").unit, line)


def test_the_smc4000_reads_zero() -> None:
    """D72: its analogue points are those of Modbus devices."""
    assert Desk().ask("MG @AN[1]{F2.1}") == " 00.0\r\n:"
