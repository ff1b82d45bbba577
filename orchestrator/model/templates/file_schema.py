"""The JSON Schema of a job file for editors: a job, declarations, a button, and `${name}` where values stand."""

from typing import Any, cast

from orchestrator.model.jobs.job import Job
from orchestrator.model.templates.button import ButtonDeclaration
from orchestrator.model.templates.parameters import PARAMETER_NAME, ParameterDeclarations

REFERENCE = {"type": "string", "pattern": rf"\$\{{{PARAMETER_NAME}\}}"}
_SCALARS = {"number", "integer", "boolean", "string"}
_SELECTS_KIND = {"do", "schema"}  # they select what the other fields are: written out


def make_job_file_schema() -> dict[str, Any]:
    """The schema of `tutti schema job`."""
    schema, declarations = Job.model_json_schema(), ParameterDeclarations.model_json_schema()
    button = ButtonDeclaration.model_json_schema()
    schema_below = schema["$defs"]
    for part in (schema, *schema_below.values()):
        accept_references(part, REFERENCE)
    schema_below |= declarations["$defs"] | button["$defs"]
    schema["properties"]["parameters"] = declarations["properties"]["parameters"]
    schema["properties"]["button"] = button["properties"]["button"]  # a fixed text: no references
    return schema


def accept_references(model: dict[str, Any], reference: dict[str, Any]) -> None:
    """Let the scalars in the fields of a model be references too. reference: the schema of one."""
    fields: dict[str, Any] = model.get("properties", {})
    for name, field in fields.items():
        if name not in _SELECTS_KIND:
            fields[name] = _widen(field, reference)


def _widen(field: dict[str, Any], reference: dict[str, Any]) -> dict[str, Any]:
    """The schema of a value, or of what is inside a list or a mapping, that may also be a reference."""
    changed_field = dict(field)
    if "items" in field:
        changed_field["items"] = _widen(field["items"], reference)
    for key in ("additionalProperties", "patternProperties"):
        inner = field.get(key)
        if key == "patternProperties" and inner is not None:
            changed_field[key] = {pattern: _widen(option, reference) for pattern, option in inner.items()}
        elif isinstance(inner, dict):
            changed_field[key] = _widen(cast(dict[str, Any], inner), reference)
    options = field.get("anyOf")
    if options is not None:
        new_options = [
            _widen(option, reference) if option.get("type") not in _SCALARS else option for option in options
        ]
        scalar = any(option.get("type") in _SCALARS or "enum" in option for option in options)
        any_text = any(_takes_any_text(option) for option in options)
        changed_field["anyOf"] = [*new_options, reference] if scalar and not any_text else new_options
        return changed_field
    if field.get("type") not in _SCALARS or _takes_any_text(field):
        return changed_field
    about = {key: changed_field.pop(key) for key in ("description", "default", "title") if key in changed_field}
    return {**about, "anyOf": [changed_field, reference]}


def _takes_any_text(schema: dict[str, Any]) -> bool:
    return schema.get("type") == "string" and not schema.keys() & {"pattern", "enum", "const"}
