"""The texts of errors are bounded, whatever a controller has sent."""

import pickle
from typing import cast

import pytest

from orchestrator.model.errors import MAX_ERROR_TEXT, ControllerFault, Refusal
from orchestrator.model.text.text_fields import MAX_SHOWN


@pytest.mark.parametrize("length", [0, MAX_ERROR_TEXT, MAX_ERROR_TEXT + 1, 100_000])
def test_a_long_text_loses_its_middle_and_says_so(length: int) -> None:
    text = "b" + "x" * max(0, length - 2) + "e"
    for error in (Refusal("garbage", text, "check the cable"), ControllerFault("garbage", text, "check the cable")):
        assert len(error.text) <= MAX_ERROR_TEXT < MAX_SHOWN and str(error) == error.text
        assert error.text.startswith("b") and error.text.endswith("e")
        assert ("are left out" in error.text) is (len(text) > MAX_ERROR_TEXT)
        if isinstance(error, Refusal):
            assert cast(Refusal, pickle.loads(pickle.dumps(error))).text == error.text
