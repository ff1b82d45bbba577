"""The findings of the contract suite: what does not hold, and what does not apply to a make."""

from collections.abc import Awaitable
from typing import TypeVar

from orchestrator.model.errors import TuttiError

_Error = TypeVar("_Error", bound=Exception)


class ContractBroken(TuttiError):
    """A driver that does not do what the contract demands. The text states what was found."""


class NotApplicable(TuttiError):
    """A check of something that this make does not offer."""


def require(condition: object, text: str) -> None:
    """Raise `ContractBroken` with `text` unless the condition holds."""
    if not condition:
        raise ContractBroken(text)


async def require_error(call: Awaitable[object], what: str, *kinds: type[_Error]) -> _Error:
    """Await a call that must raise one of `kinds`, and return that error. Raises `ContractBroken`."""
    try:
        await call
    except kinds as error:
        return error
    names = " or ".join(kind.__name__ for kind in kinds)
    raise ContractBroken(f"{what} raised no {names}")
