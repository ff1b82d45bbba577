"""What a process answers to a request, for both buses: the handlers of what it serves, by the key or wildcard that was
requested."""

from collections.abc import Callable, Sequence

from orchestrator.bus.base import RequestHandler, ServedGroup
from orchestrator.bus.expression import expressions_intersect, is_silent_on, is_wild

FindAnswers = Callable[[str], Sequence[tuple[str, RequestHandler]]]
"""Returns the keys to answer on for a requested key or wildcard, each with its handler; empty: there is no answer."""


def answer_expression(expression: str, handler: RequestHandler) -> FindAnswers:
    """The answers of a process that serves `expression` by one handler."""

    def find_answers(requested: str) -> Sequence[tuple[str, RequestHandler]]:
        if is_silent_on(expression, requested):
            return ()
        return ((expression if is_wild(requested) else requested, handler),)

    return find_answers


def answer_group(group: ServedGroup) -> FindAnswers:
    """The answers of a process that serves the keys of `group`."""

    def find_answers(requested: str) -> Sequence[tuple[str, RequestHandler]]:
        if is_wild(requested):
            keys = [key for key in group.list_values() if expressions_intersect(requested, key)]
        else:
            keys = [requested]
        return [(key, handler) for key in keys if (handler := group.find_handler(key)) is not None]

    return find_answers
