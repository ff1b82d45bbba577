"""`--speed` of commands that move axes once."""

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


class SpeedType(click.ParamType[float | str]):
    """A fraction of the limits, as a number or in percent, a speed with its unit, or `manual`."""

    name = "speed"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        """Raises `click.BadParameter`."""
        from orchestrator.model.numbers import split_number
        from orchestrator.model.steps.speed import MANUAL, read_speed

        if value == MANUAL:
            return value
        try:
            # On the command line every number is text.
            number = split_number(str(value))
            return read_speed(float(number[0]) if number is not None and not number[1] else value, "the speed")
        except ValueError as error:
            self.fail(str(error), param, ctx)


def speed_option(command: F) -> F:
    """Add the option `--speed`."""
    return click.option(
        "--speed",
        default="manual",
        metavar="SPEED",
        type=SpeedType(),
        help='A fraction of the limits (0.5, "50 %"), or a speed ("5 mm/s"); default: `manual_speed` of each axis.',
    )(command)
