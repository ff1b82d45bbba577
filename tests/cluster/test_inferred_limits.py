"""An SMC30 cannot be asked for its switches: that one has ended a motion is concluded, and refuses no later motion."""

from pathlib import Path

import pytest

from tutti import JobFailed
from tutti.testing import virtual_fleet

SMC30 = Path(__file__).parents[2] / "deploy" / "examples" / "smc30.fleet.yaml"


def test_a_switch_that_was_released_does_not_refuse_the_next_move_in_its_direction() -> None:
    with virtual_fleet(SMC30, seed=1, check=False) as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        fleet.press_limit("smc30.z", "forward", at="1 s")
        with pytest.raises(JobFailed, match="end-of-travel"):
            fleet.tutti.move({"smc30.z": 20}, speed=0.5)
        assert fleet.tutti.axes()["smc30.z"].limit == "forward"
        fleet.press_limit("smc30.z", "none")
        assert fleet.tutti.move({"smc30.z": 20}, speed=0.5).state == "done"
        assert fleet.tutti.axes()["smc30.z"].limit == "none"
