"""Durations that the user gives: text with a unit; seconds in the program."""

import re
from typing import Any

import click

DURATION = re.compile(r"^\s*(\d+(?:\.\d*)?)\s*(s|min|h|d|w)\s*$")
_SECONDS = {"s": 1, "min": 60, "h": 3600, "d": 86_400, "w": 7 * 86_400}


class DurationType(click.ParamType[float]):
    """A duration such as `90d`, `2h`, `1.5min`: seconds. at_most: the longest one that is allowed, in its own words."""

    name = "duration"

    def __init__(self, at_most: str = "36600d") -> None:
        self._at_most = at_most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        match = DURATION.match(str(value))
        if not match:
            self.fail(f"{value!r}: write a number and s, min, h, d or w, e.g. 90d", param, ctx)
        seconds, most = _to_seconds(match), DURATION.match(self._at_most)
        assert most is not None
        if seconds > _to_seconds(most):
            self.fail(f"{value} is too long: at most {self._at_most}", param, ctx)
        return seconds


def _to_seconds(found: re.Match[str]) -> float:
    return float(found[1]) * _SECONDS[found[2]]
