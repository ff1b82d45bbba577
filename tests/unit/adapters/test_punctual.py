"""How late a start may be written if the fleet file does not set it: what the host can guarantee."""

from types import SimpleNamespace
from typing import cast

import pytest

from adapters.contract import TimedWriter
from adapters.host.makes import find_make
from adapters.toolkit.firing import ORDINARY_DELAY_US, FiringOptions, apply_writer_delay
from orchestrator.link.timed_write import WriteOrder, write_at_instant

FIRER = cast(TimedWriter, SimpleNamespace(max_delay_us=ORDINARY_DELAY_US))


@pytest.mark.parametrize("make", ["shrc203", "smc30", "ppsmc", "cia402"])
def test_a_host_without_real_time_promises_less_unless_the_fleet_file_overrides_it(make: str) -> None:
    options = find_make(make).options_model
    default = apply_writer_delay(FIRER, options.model_validate({}))
    given = apply_writer_delay(FIRER, options.model_validate({"fire_late_us": 300}))
    assert isinstance(default, FiringOptions) and default.fire_late_us == ORDINARY_DELAY_US
    assert isinstance(given, FiringOptions) and given.fire_late_us == 300


@pytest.mark.parametrize("make", ["smc4000", "smc2000"])
def test_a_make_that_is_not_started_by_timed_bytes_promises_nothing(make: str) -> None:
    options = find_make(make).options_model.model_validate({})
    assert apply_writer_delay(FIRER, options) is options


def test_the_delay_of_a_start_counts_to_the_end_of_its_write() -> None:
    """The processor was taken away after the look at the clock."""
    instants = iter((1_000, 13_000_000))
    fired = write_at_instant(WriteOrder(b"G", 900, 5_000), lambda: next(instants), lambda _: None)
    assert (fired.written_ns, fired.after_ns, fired.late) == (1_000, 13_000_000 - 900, False)
