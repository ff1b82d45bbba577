"""The description of the HTTP interface for programs (OpenAPI 3.1), made from the models of requests and replies."""

import re
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from inspect import getdoc
from typing import Any

from pydantic.json_schema import models_json_schema

from orchestrator.bus.service_verbs import CONTROLLER_VERBS, SERVICE_VERBS, ServiceVerb
from orchestrator.gateway.access.roles import LEAST_ROLES
from orchestrator.model.base import Model
from orchestrator.model.messages import RawRequest, RefusalDetails

_PLACE = "#/components/schemas/{model}"
_GIVEN = ("request_id", "actor")  # by the gateway


def make_openapi(reads: Iterable[str]) -> dict[str, Any]:
    """The description. reads: the paths of GET."""
    paths = {path: {"get": _describe_read(path)} for path in reads}
    names, schemas = _make_schemas()
    for verb, models in SERVICE_VERBS.items():
        paths.setdefault(f"/v1/{verb}", {})["post"] = _describe_verb(verb, models, names)
    for verb, models in CONTROLLER_VERBS.items():
        paths[f"/v1/controllers/{{controller}}/{verb}"] = {"post": _describe_verb(verb, models, names)}
    for path, text in _OWN.items():
        paths.setdefault(path, {})["post"] = _describe_own(path, text)
    return {
        "openapi": "3.1.0",
        "info": {"title": "Tutti", "version": version("tutti"), "description": _TEXT},
        "paths": dict(sorted(paths.items())),
        "components": {"schemas": schemas, "securitySchemes": _SECURITY},
        "security": [{"token": []}, {"cookie": []}],
    }


_TEXT = (
    "Requests to a fleet of motion controllers. Errors are refusals: code, text, remedy. Software stops are no safety "
    "functions."
)
_SECURITY = {
    "token": {"type": "http", "scheme": "bearer", "description": "made by `tutti user token`"},
    "cookie": {"type": "apiKey", "in": "cookie", "name": "tutti_session_FLEET_PORT"},
}
_OWN = {
    "/v1/login": 'Begin a session: {"user", "password"}.',
    "/v1/logout": "End the session.",
    "/v1/estop": 'E-stop of all controllers: {"reason"}. Needs no coordinator.',
    "/v1/reset": "Release the e-stop latch of all controllers, and clear faults.",
    "/v1/check-job": 'Check a job file: {"text", "template" or "program", "values"}. Nothing moves.',
    "/v1/check-fleet": 'Compare a fleet file with the running fleet: {"text"}.',
}


@cache
def _make_schemas() -> tuple[dict[type[Model], str], dict[str, Any]]:
    """The schema of every model, and its name."""
    verbs = [*SERVICE_VERBS.values(), *CONTROLLER_VERBS.values()]
    requests, replies = {verb.request for verb in verbs}, {verb.reply for verb in verbs}
    ordered_requests = sorted(requests | replies | {RefusalDetails}, key=lambda model: model.__name__)
    places, definitions = models_json_schema([(model, "validation") for model in ordered_requests], ref_template=_PLACE)
    names = {model: places[model, "validation"]["$ref"].rpartition("/")[2] for model in ordered_requests}
    schemas: dict[str, Any] = definitions["$defs"]
    for request in requests:
        schema = schemas[names[request]]
        schema["properties"] = {name: value for name, value in schema["properties"].items() if name not in _GIVEN}
        optional_names = (*_GIVEN, "holder") if request is RawRequest else _GIVEN  # the gateway acquires the axes then
        schema["required"] = [name for name in schema.get("required", []) if name not in optional_names]
    return names, schemas


def _describe_verb(verb: str, models: ServiceVerb, names: dict[type[Model], str]) -> dict[str, Any]:
    body, reply = (_PLACE.format(model=names[model]) for model in (models.request, models.reply))
    key = {"name": "Idempotency-Key", "in": "header", "schema": {"type": "string"}}
    description = getdoc(models.request) or verb
    return {
        "operationId": verb,
        "summary": description.split("\n")[0],
        "description": f"Least role: {LEAST_ROLES[verb]}.",
        "parameters": [
            key,
            *_list_places(f"/v1/controllers/{{controller}}/{verb}" if verb in CONTROLLER_VERBS else ""),
        ],
        "requestBody": {"content": {"application/json": {"schema": {"$ref": body}}}},
        "responses": _describe_responses({"$ref": reply}),
    }


def _describe_read(path: str) -> dict[str, Any]:
    name = re.sub(r"[^a-z]+", "-", path.removeprefix("/v1/")).strip("-")
    return {
        "operationId": f"get-{name}",
        "summary": f"Read {name.replace('-', ' ')}.",
        "parameters": _list_places(path),
        "responses": _describe_responses({"type": "object"}),
    }


def _describe_own(path: str, text: str) -> dict[str, Any]:
    return {
        "operationId": path.removeprefix("/v1/"),
        "summary": text,
        "requestBody": {"content": {"application/json": {"schema": {"type": "object"}}}},
        "responses": _describe_responses({"type": "object"}),
    }


def _list_places(path: str) -> list[dict[str, Any]]:
    return [
        {"name": name, "in": "path", "required": True, "schema": {"type": "string"}}
        for name in re.findall(r"{(\w+)}", path)
    ]


def _describe_responses(schema: dict[str, Any]) -> dict[str, Any]:
    refusal_schema = {"type": "object", "properties": {"refused": {"$ref": _PLACE.format(model="RefusalDetails")}}}
    return {
        "200": {"description": "done", "content": {"application/json": {"schema": schema}}},
        "default": {"description": "refused", "content": {"application/json": {"schema": refusal_schema}}},
    }
