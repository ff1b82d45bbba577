"""Rounds of random numbers: a few in every run, more at night."""

from collections.abc import Sequence
from typing import Any

import pytest


def share_with_nightly(rounds: Sequence[Any], every_run: int) -> list[Any]:
    """Rows that differ in nothing but their random numbers: the first ones are for every run, the others nightly."""
    return [
        *rounds[:every_run],
        *(
            pytest.param(*(each if isinstance(each, tuple) else (each,)), marks=pytest.mark.nightly)
            for each in rounds[every_run:]
        ),
    ]
