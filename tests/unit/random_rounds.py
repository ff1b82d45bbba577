"""Rounds of random numbers, and close rows of a grid: a few in every run, more at night."""

from collections.abc import Sequence
from typing import Any

import pytest


def share_with_nightly(rounds: Sequence[Any], every_run: int) -> list[Any]:
    """Rows that differ in their random numbers, or are further instants and settings of one grid: the first ones are for
    every run, the others nightly."""
    return [
        *rounds[:every_run],
        *(
            pytest.param(*(each if isinstance(each, tuple) else (each,)), marks=pytest.mark.nightly)
            for each in rounds[every_run:]
        ),
    ]
