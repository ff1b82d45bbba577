"""`tutti schema`: JSON Schemas of the files, for editors."""

import click

from orchestrator.cli.base.common import print_json


@click.command(epilog="Example: tutti schema fleet > fleet.schema.json")
@click.argument("kind", type=click.Choice(["fleet", "job"]))
def schema(kind: str) -> None:
    """Print the JSON Schema of a fleet or job file, so that editors complete and check it."""
    from orchestrator.model.fleet import Fleet
    from orchestrator.model.templates.file_schema import make_job_file_schema

    print_json(Fleet.model_json_schema() if kind == "fleet" else make_job_file_schema())
