"""Galil: identification, records at the offsets that Galil publishes, and what is refused."""

from dataclasses import replace
from typing import Any

import pytest
from adapter_worlds import CASES, World, run

from adapters.contract import ConfigError
from adapters.galil.driver import MAKE
from adapters.galil.models import DMC21X3, DMC40X0, identify_family
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller
from sim.yaskawa import SMC4000


@pytest.mark.parametrize(
    ("revision", "family", "axes"),
    [("DMC2143 Rev 1.0o", DMC21X3, 4), ("DMC2183 Rev 1.0q-BISS", DMC21X3, 8), ("DMC4020 Rev 1.2a", DMC40X0, 2)],
)
def test_a_controller_is_identified_by_its_revision(revision: str, family: object, axes: int) -> None:
    assert identify_family(revision) == (family, axes)


@pytest.mark.parametrize("revision", ["DMC30010 Rev 1.2a", "RIO47100 Rev 1.0", "SMC4040 Rev 1.0a", "", "DMC4103 Rev 1"])
def test_another_controller_is_refused_with_what_it_calls_itself(revision: str) -> None:
    with pytest.raises(ControllerFault, match="DMC-21x3 and DMC-40x0") as fault:
        identify_family(revision)
    assert repr(revision) in fault.value.text


@pytest.mark.parametrize(
    ("family", "error_at", "axis_at", "axis_bytes"), [(DMC21X3, 26, 28, 28), (DMC40X0, 50, 56, 36)]
)
def test_values_of_a_record_are_where_galil_publishes_them(
    family: Any, error_at: int, axis_at: int, axis_bytes: int
) -> None:
    """Without the blocks of coordinated moves: they precede the axes in the published structure, at 44 and 82."""
    layout = family.make_format(2)
    assert layout.length == axis_at + 2 * axis_bytes and layout.command == "QR ABI"
    data = bytearray(layout.length)
    data[0:4] = bytes((0x84, 0x03)) + layout.length.to_bytes(2, "little")
    data[4:6], data[6], data[16] = (513).to_bytes(2, "little"), 0x05, 0x81
    data[error_at + 1] = 0x80
    for axis in range(2):
        at = axis_at + axis * axis_bytes
        data[at : at + 4] = bytes((0x00, 0x80, 0x0C, 9))
        for number, value in enumerate((10, 20, -10, 7, 640)):
            data[at + 4 + 4 * number : at + 8 + 4 * number] = (value + axis).to_bytes(4, "little", signed=True)
    assert bytes(data[:4]) == layout.header
    record = layout.parse_record(bytes(data), 1, 2)
    assert (record.sample, record.inputs, record.outputs, record.program_runs) == (513, 0x05, 0x81, True)
    for axis, found in enumerate(record.axes):
        assert (found.is_moving, found.stop_code, found.switches) == (True, 9, 0x0C)
        assert (found.commanded, found.actual, found.error, found.auxiliary) == (
            10 + axis,
            20 + axis,
            axis - 10,
            7 + axis,
        )
        assert found.velocity == 640 + axis


def test_the_other_family_is_a_fault_that_names_both(monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES["galil dmc40x0"]
    monkeypatch.setitem(CASES, "galil other", replace(case, simulate={**case.simulate, "family": "dmc21x3"}))

    async def main(world: World) -> None:
        with pytest.raises(ControllerFault, match="is a DMC-21x3; the fleet file says DMC-40x0") as fault:
            await world.driver.connect()
        assert fault.value.code == "config-mismatch"

    run("galil other", main)


def test_a_yaskawa_controller_is_not_a_galil(monkeypatch: pytest.MonkeyPatch) -> None:
    galil, yaskawa = CASES["galil dmc40x0"], CASES["smc4000 on TCP"]
    assert galil.controller.adapter == "galil"
    monkeypatch.setattr("orchestrator.conformance.worlds.find_simulator", lambda _: SMC4000)  # pyright: ignore[reportUnknownLambdaType]
    monkeypatch.setitem(CASES, "galil at yaskawa", replace(galil, simulate=yaskawa.simulate))

    async def main(world: World) -> None:
        with pytest.raises(ControllerFault, match="calls itself 'SMC4040"):
            await world.driver.connect()

    run("galil at yaskawa", main)


def test_every_mistake_of_the_fleet_file_is_named() -> None:
    plain = {
        **CASES["galil dmc40x0"].config,
        "link": {"kind": "udp", "host": "10.0.0.1", "port": 23},
        "axes": {
            "x": {
                "motors": ["E"],
                "unit": "mm",
                "scale": 1000,
                "limits": {"velocity": 8, "acceleration": 40, "jerk": 9},
            }
        },
    }
    with pytest.raises(ConfigError) as error:
        MAKE.check_config(Controller.model_validate(plain))
    assert [text.partition(":")[0] for text in error.value.texts] == [
        "link.kind",
        "axes.x.limits.jerk",
        "axes.x.motors",
    ]
