"""Refusals for programs."""

from typing import Any

from orchestrator.model.errors import Refusal


def describe_refusal(refusal: Refusal) -> dict[str, Any]:
    """A refusal in JSON. controller: the one that refuses, or null."""
    return {
        "code": refusal.code,
        "text": refusal.text,
        "remedy": refusal.remedy,
        "controller": refusal.controller,
    }
