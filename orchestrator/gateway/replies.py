"""Answers in JSON, and refusals with the HTTP status that fits them."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from starlette.responses import JSONResponse, Response

from orchestrator.gateway.access.refusals import describe_refusal
from orchestrator.model.base import Model
from orchestrator.model.errors import Refusal, TuttiError
from orchestrator.model.jobs.files import FileProblem

# Everything else that a fleet refuses is a conflict with its present state.
_STATUS = {
    "bad-request": 400,
    "bad-file": 422,
    "bad-job": 422,
    "not-allowed": 403,
    "no-file": 404,
    "unknown-job": 404,
    "unknown-name": 404,
    "unknown-alarm": 404,
    "unknown-position": 404,
    "absent": 503,
    "no-coordinator": 503,
    "no-answer": 504,
    "journal": 503,
    "too-many-tries": 429,
}


class RefusedRequest(TuttiError):
    """A request that is refused before the fleet sees it, with its HTTP status."""

    def __init__(self, status: int, refusal: Refusal) -> None:
        super().__init__(refusal.text)
        self.status = status
        self.refusal = refusal


def make_refusal_response(refusal: Refusal, status: int | None = None) -> Response:
    """The answer for a refusal: `{"refused": {code, text, remedy, controller}}`."""
    return JSONResponse({"refused": describe_refusal(refusal)}, status or _STATUS.get(refusal.code, 409))


def describe_problems(problems: Iterable[FileProblem]) -> list[dict[str, Any]]:
    """The mistakes of a file for programs, each with its line and field."""
    return [{"line": problem.line, "place": problem.field, "text": problem.text} for problem in problems]


def make_model_response(model: Model) -> Response:
    """The answer of the fleet, as it came."""
    return Response(model.to_json(), media_type="application/json")


def make_joined_response(plain: Mapping[str, Any], encoded: Mapping[str, bytes]) -> Response:
    """An answer of these fields, and of some that are JSON already, because another process has written them."""
    fields = [f"{json.dumps(name)}:".encode() + text for name, text in encoded.items()]
    fields += [json.dumps(dict(plain), ensure_ascii=False, allow_nan=False).encode()[1:-1]] if plain else []
    return Response(b"{" + b",".join(fields) + b"}", media_type="application/json")
