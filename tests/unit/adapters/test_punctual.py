"""How late a start may be written where the fleet file does not say it: what the host can keep."""

from types import SimpleNamespace
from typing import cast

import pytest

from adapters.contract import TimedWriter
from adapters.host.host import find_make
from adapters.toolkit.firing import ORDINARY_DELAY_US, FiringOptions, apply_writer_delay

FIRER = cast(TimedWriter, SimpleNamespace(max_delay_us=ORDINARY_DELAY_US))


@pytest.mark.parametrize("make", ["shrc203", "smc30", "ppsmc", "cia402"])
def test_a_host_that_is_no_real_time_one_promises_less_unless_the_fleet_file_says_otherwise(make: str) -> None:
    options = find_make(make).options_model
    default = apply_writer_delay(FIRER, options.model_validate({}))
    given = apply_writer_delay(FIRER, options.model_validate({"fire_late_us": 300}))
    assert isinstance(default, FiringOptions) and default.fire_late_us == ORDINARY_DELAY_US
    assert isinstance(given, FiringOptions) and given.fire_late_us == 300


@pytest.mark.parametrize("make", ["smc4000", "smc2000"])
def test_who_is_not_started_by_bytes_at_an_instant_has_nothing_to_promise(make: str) -> None:
    options = find_make(make).options_model.model_validate({})
    assert apply_writer_delay(FIRER, options) is options
