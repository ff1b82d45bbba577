"""Numbers in replies are finite, and within the range of the make, before anything uses them."""

from fractions import Fraction

import pytest

from adapters.contract import AxisReading, ControllerReading
from adapters.controller.state.readings import require_sound_reading
from adapters.ppsmc.replies import ASK_INPUTS, ASK_POSITIONS, ASK_STATUS, leading_number, parse_setting
from adapters.shrc203.wire.replies import STATUS, parse_entries, parse_status, pulse_list, speed_list
from adapters.smc30.unitstate import POSITION
from adapters.yaskawa.language.numbers import parse_error_code, parse_numbers, parse_sizes
from adapters.yaskawa.wire.handles import HandleCleaner
from adapters.yaskawa.wire.record import RecordFormat
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import ControllerFault

HOSTILE = (
    " inf", "-inf", "Infinity", "nan", "1e999", "1e999999999", "9" * 400, "9" * 5000, "0x7F", "1_0", "1/3", "", "-", ".",
    "1.2.3", "\xb2", "\u0663",
)  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE)
def test_a_number_that_no_controller_prints_is_garbage_for_every_make(text: str) -> None:
    with pytest.raises(ControllerFault) as caught:
        parse_numbers(f"1, {text}", 2, "MG")
    assert caught.value.code == "garbage" and len(caught.value.text) < 400
    assert not pulse_list(2).matches_line(f"1,{text}")
    assert not speed_list(1).matches_line(f"S1F{text}R100")
    assert not STATUS.matches_line(f"P1,{text},0,0,R,R")
    assert parse_setting(text) is None
    assert not ASK_POSITIONS.form.matches_text(f"1:{text};") or leading_number(text) is None
    assert not ASK_STATUS.form.matches_text(f"1:{text};")
    assert not POSITION.fullmatch(f"V{text}")
    assert parse_error_code(text) is None and not parse_sizes(text)


def test_numbers_that_controllers_print_are_read() -> None:
    assert parse_numbers(" 12.5000,- 3, 2147483647.9999,7.", 4, "MG") == [12.5, -3.0, 2147483647.9999, 7.0]
    assert parse_entries("+999999999,NS,-5.000") == [999_999_999, None, -5]
    assert parse_status("P+121701,-7,0,3F,R,B", (1, 2))[2].counts == -7
    assert leading_number("12.5mm") == "12.5" and leading_number("-.5") == "-.5" and leading_number("osc") is None
    assert parse_setting("0.25") == Fraction(1, 4) and parse_setting("0.25mm") is None
    assert parse_error_code("1 Unrecognized command") == 1 and parse_error_code("0") == 0
    assert ASK_INPUTS.form.matches_text("255") and not ASK_INPUTS.form.matches_text("256")
    assert ASK_POSITIONS.form.matches_text("1:-12.5mm;2:osc;")


@pytest.mark.parametrize("line", ["4,999999,0,36", "4," + "9" * 5000 + ",0,36", "4,1e3,0,36"])
def test_block_sizes_are_bounded(line: str) -> None:
    with pytest.raises(ControllerFault, match="after 'QZ' expected"):
        RecordFormat.from_sizes(line)


@pytest.mark.parametrize("number", [-1.0, 8.0, 2147483647.0])
def test_a_handle_that_does_not_exist_is_garbage(number: float) -> None:
    class Session:
        async def read_many(self, operands: list[str]) -> list[float]:
            return [number, *[0.0] * (len(operands) - 1)]

    async def main(_: VirtualClock) -> None:
        session: object = Session()
        with pytest.raises(ControllerFault, match="handles are 0 to 7"):
            await HandleCleaner().close_stale_handles(session)  # pyright: ignore[reportArgumentType]

    run_virtual(main)


@pytest.mark.parametrize("value", [float("inf"), float("-inf"), float("nan"), 1e30])
@pytest.mark.parametrize("field", ["commanded_counts", "actual_counts", "velocity_counts_s"])
def test_a_reading_beyond_every_controller_is_a_fault(field: str, value: float) -> None:
    axis = {"commanded_counts": 0, "actual_counts": 0.0, "velocity_counts_s": 0.0} | {field: value}
    reading = ControllerReading(0, {"x": AxisReading(**axis, moving=False, enabled=True)})  # pyright: ignore[reportArgumentType]
    with pytest.raises(ControllerFault, match="is not within") as caught:
        require_sound_reading(reading)
    assert caught.value.axis == "x"
