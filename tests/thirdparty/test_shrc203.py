"""A simulated SHRC-203 on a pseudo-terminal, driven by a driver from PyPI and by a plain pyvisa script."""

import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from children import Children, wait_until

sys.path.insert(0, str(Path(__file__).parent))

from shrc203_driver import driver_class

BAUD = 9600
"""The driver sets it."""
ORIGIN = -1500
UNIT = {"origin_pls": {"1": ORIGIN}, "divide": 20, "speed": [100, 20_000, 100], "origin_speed": [100, 20_000, 100]}
"""One pulse is 100 nm."""
PULSES_PER_UM = 10


class Unit:
    """A simulated controller, its address, and its true motions."""

    def __init__(self, children: Children) -> None:
        self.port = children.folder / "ports" / "stage"
        self._truth = children.folder / "truth.jsonl"
        children.simulator(
            "shrc203",
            f"pty:{self.port}",
            "--baud",
            str(BAUD),
            "--options",
            json.dumps(UNIT),
            "--truth",
            str(self._truth),
        )

    @property
    def resource(self) -> str:
        return f"ASRL{self.port}::INSTR"

    def ends(self) -> list[tuple[str, int]]:
        """Axis and place of every motion that has ended."""
        whole = self._truth.read_text().rpartition("\n")[0] if self._truth.exists() else ""
        entries = [json.loads(line) for line in whole.splitlines()]
        return [(each["axis"], round(each["end_counts"])) for each in entries if each["event"] == "end"]

    def ended(self, count: int) -> tuple[str, int]:
        wait_until(lambda: len(self.ends()) >= count, f"the end of motion {count}")
        return self.ends()[-1]


@pytest.fixture
def unit(children: Children, monkeypatch: pytest.MonkeyPatch) -> Unit:
    monkeypatch.setenv("PYVISA_LIBRARY", "@py")
    return Unit(children)


def opened(unit: Unit) -> Any:
    """A plain pyvisa resource."""
    resource: Any = import_module("pyvisa").ResourceManager("@py").open_resource(unit.resource)
    resource.baud_rate = BAUD
    resource.write_termination = resource.read_termination = "\r\n"
    resource.timeout = 5000
    return resource


def coordinates(reply: str) -> list[int]:
    """The first three fields of `Q:`: sign at the left edge, digits at the right one."""
    return [int(field.replace(" ", "")) for field in reply.split(",")[:3]]


def test_the_driver_from_pypi_homes_moves_and_reads(unit: Unit) -> None:
    driver = driver_class()(unit.resource)
    driver.open_connection()
    driver.set_mode()
    driver.set_unit("U")
    driver.home(1)
    assert driver.get_position(1) == 0
    assert unit.ended(1) == ("1", ORIGIN)  # counted from where it was switched on; from here on it is 0
    driver.move(250, 1)
    assert unit.ended(2) == ("1", 250 * PULSES_PER_UM)
    # It does not read the answers to its settings, so that it takes an older state for the present one.
    driver.wait_for_ready(1)
    driver.move_relative(-50, 1)
    assert unit.ended(3) == ("1", 200 * PULSES_PER_UM)
    assert driver.get_position(1) == 200
    assert driver.get_speed(1) == ("100", "20000", "100")
    driver.close()
    plain = opened(unit)
    reply = plain.query("Q:")
    while len(reply) != 38:  # the answer to the driver's unread query is still coming
        reply = plain.read()
    assert coordinates(reply) == [2000, 0, 0]
    plain.close()


def test_a_plain_pyvisa_script_reads_and_moves(unit: Unit) -> None:
    plain = opened(unit)
    assert plain.query("*IDN?").startswith("SIGMAKOKI,SHRC-203")
    reply = plain.query("Q:")
    assert len(reply) == 38 and coordinates(reply) == [0, 0, 0] and reply.endswith(",K,K,R")
    assert plain.query("MP:A+P1000-P500,S100F20000R50S100F20000R50") == "OK"
    assert plain.query("G:A") == "OK"
    assert sorted([plain.read(), plain.read()]) == ["1", "2"]
    assert coordinates(plain.query("Q:")) == [1000, -500, 0]
    assert plain.query("nonsense") == "NG"
    plain.close()
