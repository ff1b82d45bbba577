"""The option for a picture's file, and its writing."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from orchestrator.cli.base.codes import FAILED
from orchestrator.cli.base.errors import exit_with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

F = TypeVar("F", bound=Callable[..., Any])

SUFFIXES = (".png", ".svg")


def picture_option(text: str) -> Callable[[F], F]:
    """Add the option `-o`, `--out`: a file whose suffix says which kind of picture it is."""
    return click.option(
        "-o",
        "--out",
        type=click.Path(dir_okay=False, path_type=Path),
        callback=_check_suffix,
        default=None,
        help=f"{text} PNG or SVG by the suffix.",
    )


def _check_suffix(_: click.Context, option: click.Parameter, value: Path | None) -> Path | None:
    if value is None or value.suffix in SUFFIXES:
        return value
    raise click.BadParameter(f"{value}: write a name that ends in {' or '.join(SUFFIXES)}", param=option)


def write_picture(figure: "Figure", path: Path) -> None:
    """Write a picture; a file that cannot be written ends the command."""
    try:
        figure.savefig(path)  # pyright: ignore[reportUnknownMemberType]
    except OSError as error:
        exit_with_error(f"{path} cannot be written: {error.strerror}", FAILED, "choose another file: --out")
