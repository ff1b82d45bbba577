"""A simulated SMC-4000 on TCP, driven by the Galil controller class of ESRF's bliss, which ends every command with a
semicolon."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from children import Children, tell, wait_until

sys.path.insert(0, str(Path(__file__).parent))

from galil_driver import driver_class

SETTINGS = {"model_id": "SMC4040", "limit_switches": "ACTIVE_LOW"}


@pytest.fixture
def simulated(children: Children) -> tuple[Any, int]:
    process, ready = children.simulator("smc4000", "tcp:127.0.0.1:0")
    return process, ready["port"]


@pytest.fixture
def driver(simulated: tuple[Any, int]) -> Iterator[Any]:
    controller = driver_class()("galil", {"host": "127.0.0.1", "port": simulated[1], **SETTINGS})
    controller.initialize()
    yield controller
    controller.close()


def axis_of(driver: Any, channel: str) -> Any:
    axis = SimpleNamespace(name=channel.lower(), channel=channel, config={"channel": channel})
    driver.initialize_axis(axis)
    driver.initialize_hardware_axis(axis)
    return axis


def test_the_driver_from_pypi_moves_and_reads(driver: Any) -> None:
    assert driver.get_firmware() == "SMC4040 Rev 1.0a"
    axis = axis_of(driver, "A")
    driver.set_on(axis)
    driver.set_velocity(axis, 20_000)
    driver.set_acceleration(axis, 1_024_000)
    assert (driver.read_velocity(axis), driver.read_acceleration(axis)) == (20_000, 1_024_000)
    driver.prepare_move(SimpleNamespace(axis=axis, target_pos=5000))
    driver.start_one(SimpleNamespace(axis=axis))
    assert "MOVING" in driver.state(axis)
    wait_until(lambda: driver.state(axis) == {"READY"}, "the end of the move")
    assert driver.read_position(axis) == driver.read_encoder(axis) == 5000
    driver.prepare_move(SimpleNamespace(axis=axis, target_pos=5_000_000))
    driver.start_one(SimpleNamespace(axis=axis))
    driver.stop(axis)
    wait_until(lambda: driver.state(axis) == {"READY"}, "the end of the stop")
    assert 5000 <= driver.read_encoder(axis) < 50_000
    with pytest.raises(RuntimeError, match="Invalid command"):
        driver.raw_write_read("XX")


def test_the_driver_stays_in_step_over_hundreds_of_commands(driver: Any, simulated: tuple[Any, int]) -> None:
    """Each ended by a semicolon alone; 80 characters are a dozen of them."""
    axis = axis_of(driver, "B")
    for _ in range(100):
        assert driver.read_position(axis) == 0
        assert driver.get_TB()["executing_program"] is False
    assert len(driver.get_com_info()) == 9
    tell(simulated[0], limit=["Y", "forward"])
    wait_until(lambda: "LIMPOS" in driver.state(axis), "the limit switch")
    assert "SMC4040" in driver.__info__()
    assert "Invalid" not in driver.get_hw_info()
