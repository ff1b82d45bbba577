"""Numbers of steps that the user types: from 1; the index from 0 in the program."""

from typing import Any

import click


class StepType(click.IntRange):
    """The number of a step, as texts and tables have it: its index."""

    def __init__(self) -> None:
        super().__init__(1)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        return int(super().convert(value, param, ctx)) - 1
