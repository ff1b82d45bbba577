"""The JSON Schemas of fleet files and their fragments for editors: a fleet, short forms, and `{name}` in values."""

from typing import Any, cast

from orchestrator.model.base import ID_PATTERN
from orchestrator.model.expansion.fragments import DEFAULTS, FRAGMENT_SCHEMA, INCLUDE, SCHEMA, SECTIONS
from orchestrator.model.expansion.members import COUNT, EACH, ITEM, MAX_MEMBERS
from orchestrator.model.expansion.variables import VARIABLE, VARIABLE_NAME
from orchestrator.model.fleet import Fleet
from orchestrator.model.templates.file_schema import accept_references

NAME_PATTERN = rf"^([a-z0-9_-]|{VARIABLE})+$"
_SCALAR = {"type": ["number", "string", "boolean"]}
_VALUES = {"type": "object", "patternProperties": {f"^{VARIABLE_NAME}$": _SCALAR}, "additionalProperties": False}
_RANGE_OR_LIST = {"anyOf": [{"type": "string", "pattern": r"\.\."}, {"type": "array", "items": _SCALAR, "minItems": 1}]}
_CONTROLS = {COUNT: {"$ref": "#/$defs/Count"}, EACH: {"$ref": "#/$defs/Each"}}
_MODELS: dict[str, Any] = {
    "Count": {
        "description": "This entry so many times, with {n} = 1, 2, …",
        "anyOf": [{"type": "integer", "minimum": 1, "maximum": MAX_MEMBERS}, {"type": "string", "pattern": VARIABLE}],
    },
    "Each": {
        "description": "This entry once for each combination of the values of variables, or for each entry of a list.",
        "anyOf": [
            {
                "type": "object",
                "patternProperties": {f"^{VARIABLE_NAME}$": _RANGE_OR_LIST},
                "additionalProperties": False,
                "minProperties": 1,
            },
            {"type": "array", "items": _VALUES, "minItems": 1},
        ],
    },
    "ShortItem": {
        "description": "Entries that are no mappings, written once for many.",
        "type": "object",
        "properties": {**_CONTROLS, ITEM: {"description": "The entry, with variables {name}."}},
        "required": [ITEM],
        "additionalProperties": False,
    },
    "Inclusion": {
        "type": "object",
        "properties": {
            **_CONTROLS,
            "file": {"type": "string", "description": "A fragment, from the folder of this file."},
            "with": {**_VALUES, "description": "The values of its variables."},
        },
        "required": ["file"],
        "additionalProperties": False,
    },
}
_ONE_INCLUSION = {"anyOf": [{"type": "string"}, {"$ref": "#/$defs/Inclusion"}]}
_INCLUDE = {
    "description": "Fragments, whose sections are added to this file.",
    "anyOf": [*_ONE_INCLUSION["anyOf"], {"type": "array", "items": _ONE_INCLUSION}],
}


def make_fleet_file_schema() -> dict[str, Any]:
    """The schema of `tutti schema fleet`."""
    schema = Fleet.model_json_schema()
    models: dict[str, dict[str, Any]] = schema["$defs"]
    for model in (schema, *models.values()):
        accept_references(model, {"type": "string", "pattern": VARIABLE})
    for model in [schema, *models.values()]:
        for field in model.get("properties", {}).values():
            _accept_short_entries(field, models)
    models |= _MODELS
    schema["properties"][INCLUDE] = _INCLUDE
    schema["required"].remove("controllers")  # they may all be in fragments
    return schema


def make_fragment_schema() -> dict[str, Any]:
    """The schema of `tutti schema fragment`: what a fragment may have of a fleet file."""
    schema = make_fleet_file_schema()
    fields = {name: schema["properties"][name] for name in (*SECTIONS, INCLUDE)}
    fields[DEFAULTS] = {**_VALUES, "description": "The values of variables that an inclusion does not give."}
    text = "Sections of a fleet file, which includes them, with variables."
    head = {"title": "Fragment", "description": text, "required": [SCHEMA]}
    return {**schema, **head, "properties": {SCHEMA: {"const": FRAGMENT_SCHEMA, "type": "string"}, **fields}}


def _accept_short_entries(field: dict[str, Any], models: dict[str, dict[str, Any]]) -> None:
    """Let the entries of a mapping or list stand for many."""
    for option in field.get("anyOf", ()):
        _accept_short_entries(option, models)
    if isinstance(field.get("items"), dict):
        field["items"] = _make_short(field["items"], models)
    patterns = cast(dict[str, dict[str, Any]], field.get("patternProperties", {}))
    if ID_PATTERN in patterns:
        patterns[NAME_PATTERN] = _make_short(patterns.pop(ID_PATTERN), models)


def _make_short(entry: dict[str, Any], models: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The schema of an entry that may have `count` or `each`: beside its own fields, or with `item`."""
    name = str(entry.get("$ref", "")).rpartition("/")[2]
    if "properties" in models.get(name, {}):
        models[name]["properties"] |= _CONTROLS
        return entry
    _accept_short_entries(entry, models)
    return {"anyOf": [entry, {"$ref": "#/$defs/ShortItem"}]}
