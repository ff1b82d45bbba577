"""`tutti job parameters`: what a job file asks for."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.common import console, json_option, print_json
from orchestrator.cli.base.errors import expected_errors

if TYPE_CHECKING:
    from orchestrator.model.templates.parameters import Parameter


@click.command(epilog="Example: tutti job parameters scan.template.job.yaml --json")
@click.argument("file", type=click.Path(path_type=Path))
@json_option
def parameters(file: Path, *, as_json: bool) -> None:
    """List the parameters of the job file FILE: type, unit, default, bounds and meaning. Nothing is connected.

    `tutti submit FILE --set NAME=VALUE` gives them values; one without a default must have one.
    """
    with expected_errors():
        _list_parameters(file, as_json=as_json)


def _list_parameters(file: Path, *, as_json: bool) -> None:
    from orchestrator.model.templates.parameters import describe_parameter
    from orchestrator.model.templates.template import Template
    from orchestrator.monitor.tables import make_plain_table

    parameters = Template.load(file).parameters
    if as_json:
        print_json([{"name": name, **describe_parameter(parameter)} for name, parameter in parameters.items()])
        return
    if not parameters:
        console.print(f"{file} has no parameters", highlight=False, markup=False, soft_wrap=True)
        return
    table = make_plain_table(["parameter", "type", "unit", "default>", "allowed", "meaning"], ["meaning"])
    for name, parameter in parameters.items():
        plain = describe_parameter(parameter)
        default = "required" if plain["required"] else _format_value(parameter, plain["default"])
        table.add_row(
            name, parameter.type, plain["unit"] or "", default, _describe_range(parameter, plain), parameter.description
        )
    console.print(table)


def _describe_range(parameter: "Parameter", plain: dict[str, Any]) -> str:
    if plain["choices"]:
        return ", ".join(plain["choices"])
    low, high = (None if plain[end] is None else _format_value(parameter, plain[end]) for end in ("min", "max"))
    if low is not None and high is not None:
        return f"{low} to {high}"
    return f"at least {low}" if low is not None else f"at most {high}" if high is not None else ""


def _format_value(parameter: "Parameter", value: Any) -> str:
    return parameter.read_value(value).text
