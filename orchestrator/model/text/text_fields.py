"""Fields of models with text from outside."""

from typing import Any

from pydantic import AfterValidator, BeforeValidator

from orchestrator.model.text.outside_text import explain_hidden, show_text

MAX_SHOWN = 20_000
"""Characters of a free text: its escapes are not looked for in a longer one, which no field takes."""


def _show_any(value: Any) -> Any:
    if isinstance(value, str) and len(value) > MAX_SHOWN:
        raise ValueError(f"has {len(value)} characters; shorten it")
    return show_text(value) if isinstance(value, str) else value


def _refuse_hidden(name: str) -> str:
    if problem := explain_hidden(name):
        raise ValueError(problem)
    return name


SHOW_TEXT = BeforeValidator(_show_any)
"""For a free text of a request: a stop is not refused because its reason has a control character."""

PLAIN_TEXT = AfterValidator(_refuse_hidden)
"""For a new name: what cannot be seen, or would be obeyed, is refused."""
