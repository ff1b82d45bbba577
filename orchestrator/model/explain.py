"""Errors of pydantic in the words of a file: the value found, and what is allowed."""

import difflib
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, cast

from pydantic import BaseModel, ValidationError

from orchestrator.model.numbers import suggest_flag, suggest_number
from orchestrator.model.problems import MAX_DESCRIBED, Problem, counts_too_many, summarise_problems

MAX_SHOWN = 60  # characters of a value
MAX_COUNTED = 20_000  # mistakes of a file; of more than these not even the first ones are explained

_BOUNDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


def list_problems(error: ValidationError, model: type[BaseModel]) -> list[Problem]:
    """All mistakes of `error`, each with its place below `model`; of very many the first ones, and their number."""
    summary = [summarise_problems(error)] if counts_too_many(error) else []
    if error.error_count() > MAX_COUNTED:
        return summary
    problems = [
        Problem(tuple(details["loc"]), explain_error(cast(Mapping[str, Any], details), model), details["input"])
        for details in error.errors(include_url=False)[:MAX_DESCRIBED]
    ]
    return [*problems, *summary]


def explain_error(error: Mapping[str, Any], model: type[BaseModel]) -> str:
    """The text for one of pydantic's errors in a document for `model`."""
    kind, context = str(error["type"]), cast(Mapping[str, Any], error.get("ctx", {}))
    value = error.get("input")
    match kind:
        case "missing":
            return "is missing"
        case "extra_forbidden":
            return _explain_unknown_field(error, model)
        case "value_error":
            return str(context.get("error", error["msg"]))
        case "literal_error" | "enum":
            return f"found {show_value(value)}; allowed: {context['expected']}{_suggest_choice(value, context)}"
        case "union_tag_invalid":
            tags, discriminator = context["expected_tags"], context["discriminator"]
            return f"found {context['tag']!r} for {discriminator}; allowed: {tags}"
        case "union_tag_not_found":
            return f"needs the field {context['discriminator']}, which selects its kind"
        case "string_pattern_mismatch":
            return f"found {show_value(value)}; an id may contain only a-z, 0-9, _ and -"
        case "too_short" | "string_too_short":
            return f"found {show_value(value)}; at least {context['min_length']} must be given"
        case "too_long" | "string_too_long":
            return f"has {len(cast(str, value))} entries or characters; at most {context['max_length']}"
        case "finite_number":
            return f"found {show_value(value)}; the number must be finite"
        case _ if kind in _BOUNDS:
            field, words = _BOUNDS[kind]
            return f"found {show_value(value)}; must be {words} {context[field]:g}"
        case _:
            return f"found {show_value(value)}; {_expect_type(kind, value) or _lower_first(str(error['msg']))}"


def show_value(value: object) -> str:
    """A value as a message shows it, shortened."""
    try:
        text = (
            repr(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else json.dumps(value)
        )
    except (TypeError, ValueError):
        text = str(type(value))
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 1]}…"


def _expect_type(kind: str, found: object) -> str:
    """What to write where a value of another type is expected; empty for other kinds of error."""
    type_name = kind.removesuffix("_type").removesuffix("_parsing").removesuffix("_from")
    text = found if isinstance(found, str) else ""
    if type_name in ("float", "int"):
        number = "a number" if type_name == "float" else "a whole number"
        return f"must be {number}" + (f"; {hint}" if (hint := suggest_number(text)) else "")
    if type_name == "bool":
        return suggest_flag(text) if text else "must be true or false"
    if type_name == "string":
        needs_quotes = isinstance(found, int | float) and not isinstance(found, bool)
        return "must be text" + (f'; write it in quotes: "{found}"' if needs_quotes else "")
    return {"list": "must be a list", "dict": "must be a mapping", "model": "must be a mapping"}.get(type_name, "")


def _suggest_choice(found: object, context: Mapping[str, Any]) -> str:
    choices = [part.strip(" '") for part in str(context["expected"]).replace(" or ", ",").split(",")]
    matches = difflib.get_close_matches(found, choices, 1) if isinstance(found, str) else []
    return f"; did you mean {matches[0]!r}?" if matches else ""


def _explain_unknown_field(error: Mapping[str, Any], model: type[BaseModel]) -> str:
    *path, name = cast(Sequence[str | int], error["loc"])
    allowed_fields = find_fields(model, path)
    if not allowed_fields:
        return "unknown field; see `tutti schema` for the fields that are allowed here"
    matches = difflib.get_close_matches(str(name), allowed_fields, 1)
    return f"unknown field; {f'did you mean {matches[0]}? ' if matches else ''}allowed: {', '.join(allowed_fields)}"


def find_fields(model: type[BaseModel], place: Sequence[str | int]) -> list[str]:
    """The fields that `model` allows at `place`, a location of pydantic's; empty if the place is not known."""
    schema = _schema_of(model)
    node = _resolve(schema, schema)
    for part in place:
        node = _step_into(schema, node, part)
        if node is None:
            return []
    return sorted(node.get("properties", {}))


@lru_cache(maxsize=8)
def _schema_of(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema(by_alias=True)


def _resolve(schema: dict[str, Any], here: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in here:
        here = schema["$defs"][here["$ref"].rpartition("/")[2]]
    return here


def _step_into(schema: dict[str, Any], here: dict[str, Any], part: str | int) -> dict[str, Any] | None:
    here = _resolve(schema, here)
    tags: dict[str, str] = here.get("discriminator", {}).get("mapping", {})
    if part in tags:
        return _resolve(schema, {"$ref": tags[str(part)]})
    options = [_resolve(schema, option) for option in here.get("anyOf", here.get("oneOf", [here]))]
    for option in options:
        if isinstance(part, int) and "items" in option:
            return _resolve(schema, option["items"])
        if part in option.get("properties", {}):
            return _resolve(schema, option["properties"][part])
        for option_below in (option.get("additionalProperties"), *option.get("patternProperties", {}).values()):
            if isinstance(option_below, dict) and isinstance(part, str):
                return _resolve(schema, cast(dict[str, Any], option_below))
    return None


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]
