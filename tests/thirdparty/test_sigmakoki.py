"""A simulated SHRC-203 on a pseudo-terminal, driven by two packages from PyPI for Sigma Koki's stage controllers of the
SHOT command format, of which the SHRC-203 has the same commands."""

import json
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from children import Children, wait_until

# Two axes, as the packages' controllers have.
UNIT = {"controllable": [1, 2], "divide": 20, "speed": [1000, 20_000, 50], "origin_speed": [1000, 20_000, 50]}


@pytest.fixture
def ports(children: Children) -> dict[int, Path]:
    """Simulated controllers by their baud rate."""
    found: dict[int, Path] = {}
    for baud in (9600, 38400):
        found[baud] = children.folder / "ports" / f"stage{baud}"
        children.simulator("shrc203", f"pty:{found[baud]}", "--baud", str(baud), "--options", json.dumps(UNIT))
    return found


def test_pysigmakoki(ports: dict[int, Path]) -> None:
    stage: Any = import_module("sigma_koki").SHOT702()
    stage.open(str(ports[38400]), readTimeOut=5)
    stage.serial.rtscts = False
    assert stage.getVersion()
    stage.setSpeed(1000, 20_000, 50, 1000, 20_000, 50)
    stage.move(2000, -1000)
    stage.waitForReady(10)
    # After G the SHRC-203 reports the end of each axis by a line of its own.
    time.sleep(0.2)
    stage.serial.reset_input_buffer()
    assert [int(field.replace(" ", "")) for field in stage.getStatus().split(",")[:2]] == [2000, -1000]
    stage.stop()
    with pytest.raises(RuntimeError, match="NG"):
        stage.write("nonsense")
    stage.close()


def test_sigmakokipy(ports: dict[int, Path]) -> None:
    control: Any = import_module("SigmaKokiPy.SK_SHOT").StageControlShot(
        str(ports[9600]), "SHOT-702 / SHOT-302GS", 9600
    )
    assert control.SetSpeedSinglePulse(1, 20_000, 50)
    assert control.AbsoluteDriveSinglePulse(1, 1500)

    def arrived() -> bool:
        return bool(control.PositioningStatus()) and not control.IsBusy

    wait_until(arrived, "the end of the move")
    assert control.StopDriveSingle(1)
    assert control.SetLogicalOriginSingle(1)
