"""The contract of adapters, over drives of the shapes that makers give them."""

from pathlib import Path
from typing import Any

import pytest
from adapter_worlds import CAN, DRIVE, SWITCH, case
from unit.adapters.cia402_shapes import SHAPES, write_shape

from orchestrator.conformance.checks import ContractCheck
from orchestrator.conformance.findings import NotApplicable
from orchestrator.conformance.suite import CONTRACT_CHECKS
from orchestrator.conformance.worlds import Case

WITH_POINTS = ("one ramp for both", "profile by SDO")
"""Shapes that have inputs and outputs in PDOs."""
HOMES_HERE = ("two RPDOs",)
SHORT = "a power cycle while disconnected is noticed once"
"""The check that is made at each commit, of a shape: a mapping that is less than wanted is no restart."""


def make_case(shape: str, folder: Path) -> Case:
    file = write_shape(folder, SHAPES[shape])
    axis: dict[str, Any] = {**DRIVE, "homing": {"method": "37"}} if shape in HOMES_HERE else DRIVE
    made = case("cia402", CAN, {"u": "1"}, axis, {**SWITCH, "eds": file}, "can", eds=file)
    points = ("inputs", "outputs")
    config = {key: value for key, value in made.config.items() if key not in points or shape in WITH_POINTS}
    return Case(config, made.simulate, made.port)


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(check, id=check.name, marks=[] if check.title == SHORT else [pytest.mark.nightly])
        for check in CONTRACT_CHECKS
        if not check.is_long
    ],
)
@pytest.mark.parametrize("shape", [shape for shape in SHAPES if shape != "no homing"])
def test_contract(shape: str, check: ContractCheck, tmp_path: Path) -> None:
    try:
        check.run(make_case(shape, tmp_path))
    except NotApplicable as reason:
        pytest.skip(str(reason))
