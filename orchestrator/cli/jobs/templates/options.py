"""The options `--set` and `--set-file`: values for the parameters of a job file."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from orchestrator.model.templates.template import ParameterSetting

F = TypeVar("F", bound=Callable[..., Any])


def set_options(command: F) -> F:
    """Add the options `--set` and `--set-file`, as `values` and `values_file`."""
    given_option = click.option(
        "--set",
        "values",
        multiple=True,
        metavar="NAME=VALUE",
        help="A value for a parameter of the job file, e.g. --set width=20mm; repeat it for others.",
    )
    from_file = click.option(
        "--set-file",
        "values_file",
        type=click.Path(path_type=Path),
        default=None,
        help="A YAML file with values, `NAME: VALUE` in each line; --set comes before it.",
    )
    return given_option(from_file(command))


def read_settings(values: tuple[str, ...], file: Path | None) -> "dict[str, ParameterSetting]":
    """The values of both options, by name. Raises `click.BadParameter`, `FileError`."""
    from orchestrator.model.templates.template import ParameterSetting, read_settings_file

    settings: dict[str, ParameterSetting] = {}
    for text in values:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise click.BadParameter(f"{text!r}: write NAME=VALUE, e.g. width=20mm", param_hint="--set")
        name = name.strip()
        if name in settings:
            text = f"{name} is given twice, as {settings[name].value} and as {value}"
            raise click.BadParameter(text, param_hint="--set")
        settings[name] = ParameterSetting(value, "--set", written=True)
    return (read_settings_file(file) if file is not None else {}) | settings
