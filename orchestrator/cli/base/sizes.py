"""Sizes of data in options and tables: `2 GB`, `500MB`."""

import re
from typing import Any

import click

_UNITS = {"B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([kMGT]?B)")


def parse_size(text: str) -> int:
    """Return a size in bytes. Raises `ValueError`, which names the units."""
    match = _SIZE.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"{text!r} is no size; write a number and one of {', '.join(_UNITS)}, e.g. 2GB")
    return round(float(match[1]) * _UNITS[match[2]])


def format_size(count: int) -> str:
    """A size for people, with three digits: `1.43 MB`."""
    unit = next((name for name, size in reversed(_UNITS.items()) if count >= size), "B")
    return f"{count / _UNITS[unit]:.3g} {unit}" if count < 10**15 else f"{count / 10**12:.0f} TB"


class SizeType(click.ParamType[int]):
    """A size such as `2GB`: bytes."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if isinstance(value, int):
            return value
        try:
            size = parse_size(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)
        if size <= 0:
            self.fail(f"{value}: must be more than nothing", param, ctx)
        return size
