"""Options for tables of text: the separator and the decimal sign of the country whose program reads them."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import click

from orchestrator.monitor.export.csv_table import CsvStyle

F = TypeVar("F", bound=Callable[..., Any])

_SEPARATORS = {",": ",", ";": ";", "tab": "\t"}


def csv_style_options(command: F) -> F:
    """The options --separator and --decimal, as one value `csv_style`."""

    @click.option(
        "--separator", type=click.Choice(tuple(_SEPARATORS)), default=None, help="Of CSV; default: , (; with a comma)."
    )
    @click.option(
        "--decimal", type=click.Choice(("point", "comma")), default="point", show_default=True, help="Sign of CSV."
    )
    @wraps(command)
    def run(*values: Any, separator: str | None, decimal: str, **named_values: Any) -> Any:
        if decimal == "comma" and separator == ",":
            raise click.UsageError("a comma cannot be both decimal sign and separator: leave out --separator, or use ;")
        usual_separator = ";" if decimal == "comma" else ","
        style = CsvStyle(_SEPARATORS[separator or usual_separator], "," if decimal == "comma" else ".")
        return command(*values, csv_style=style, **named_values)

    return run  # pyright: ignore[reportReturnType]
