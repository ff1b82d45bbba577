"""The timing of simulated firmware: as the fleet file says, or as the adapter expects."""

from typing import Any

import pytest

from orchestrator.model.fleet import Controller
from orchestrator.runtime.simulated import find_timing

AXES = {"x": {"motors": ["1"], "unit": "mm", "scale": 1000, "limits": {"velocity": 10, "acceleration": 50}}}
MS = 1_000_000


def make_controller(adapter: str, **fields: Any) -> Controller:
    link = {"kind": "tcp", "host": "127.0.0.1", "port": 1}
    return Controller.model_validate({"adapter": adapter, "link": link, "axes": AXES, **fields})


@pytest.mark.parametrize(
    ("adapter", "options", "simulate", "timing"),
    [
        ("smc4000", {}, {}, (MS // 2, 0)),
        ("smc4000", {}, {"spread_us": 100}, (MS // 2, MS // 10)),
        ("smc4000", {"decode_us": 300}, {}, (MS // 4, MS // 20)),
        ("ppsmc", {}, {}, (5 * MS, 15 * MS)),
        ("ppsmc", {"decode_us": 1000, "decode_spread_us": 800}, {}, (MS // 2, 0)),
        ("ppsmc", {}, {"decode_us": 7000}, (7 * MS, 0)),
        ("cia402", {}, {}, (MS // 2, 0)),
    ],
)
def test_the_simulated_firmware_takes_a_time_that_the_adapter_expects(
    adapter: str, options: dict[str, Any], simulate: dict[str, Any], timing: tuple[int, int]
) -> None:
    assert find_timing(make_controller(adapter, options=options, simulate=simulate)) == timing
