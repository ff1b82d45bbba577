"""The type of an option that is a size of data."""

from typing import Any

import click

from orchestrator.model.sizes import parse_size


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
