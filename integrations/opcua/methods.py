"""Methods that check their arguments before they act, as OPC 10000-4, 5.11.2 asks."""

from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from integrations.opcua.types import ua

Check = Callable[[Any], bool]


def is_text(variant: Any) -> bool:
    """Whether an argument is a String."""
    return variant.VariantType == ua.VariantType.String and not variant.is_array


def are_texts(variant: Any) -> bool:
    """Whether an argument is an array of LocalizedText, which may be null."""
    kinds = (ua.VariantType.LocalizedText, ua.VariantType.Null)
    return variant.VariantType in kinds and (variant.Value is None or isinstance(variant.Value, list))


def is_structure(name: str) -> Check:
    """Whether an argument is the structure with this name, which is known once the nodeset is loaded."""
    return lambda variant: isinstance(variant.Value, getattr(ua, name))


def are_structures(name: str) -> Check:
    """Whether an argument is an array of the structure with this name."""

    def check(variant: Any) -> bool:
        values: list[Any] = variant.Value if variant.is_array and variant.Value is not None else [None]
        return all(isinstance(value, getattr(ua, name)) for value in values)

    return check


def make_method(checks: Sequence[Check], act: Callable[..., Awaitable[list[Any]]]) -> Callable[..., Awaitable[Any]]:
    """A method of a server. checks: of its arguments. act: is called with their values, and returns the results; what
    it does not handle is a bad status."""

    async def call(_: Any, *variants: Any) -> Any:
        if len(variants) < len(checks):
            return ua.StatusCode(ua.StatusCodes.BadArgumentsMissing)
        if len(variants) > len(checks):
            return ua.StatusCode(ua.StatusCodes.BadTooManyArguments)
        fits = [check(variant) for check, variant in zip(checks, variants, strict=True)]
        if not all(fits):
            codes = [ua.StatusCodes.Good if fit else ua.StatusCodes.BadTypeMismatch for fit in fits]
            status = ua.StatusCode(ua.StatusCodes.BadInvalidArgument)
            return ua.CallMethodResult(status, [ua.StatusCode(code) for code in codes])
        return await act(*[variant.Value for variant in variants])

    return call
