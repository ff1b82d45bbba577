"""`tutti schema`: JSON Schemas of the files, for editors."""

import click

from orchestrator.cli.base.common import print_json


@click.command(epilog="Example: tutti schema fleet > fleet.schema.json")
@click.argument("kind", type=click.Choice(["fleet", "fragment", "job"]))
def schema(kind: str) -> None:
    """Print the JSON Schema of a fleet file, a fragment or a job file, so that editors complete and check it."""
    from orchestrator.model.templates.file_schema import make_job_file_schema
    from orchestrator.model.templates.fleet_schema import make_fleet_file_schema, make_fragment_schema

    schemas = {"fleet": make_fleet_file_schema, "fragment": make_fragment_schema, "job": make_job_file_schema}
    print_json(schemas[kind]())
