"""The base of all models: strict, frozen, finite numbers only."""

import re
from fractions import Fraction
from functools import lru_cache
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, WithJsonSchema

from orchestrator.model.errors import TuttiError
from orchestrator.model.text.outside_text import show_json
from orchestrator.model.text.text_fields import SHOW_TEXT

ID_PATTERN = r"^[a-z0-9_-]+$"

Id = Annotated[str, Field(pattern=ID_PATTERN, min_length=1, max_length=64)]
"""An id as it appears in a bus key."""


def _make_cut(most: int) -> BeforeValidator:
    """Cut a longer text: a stop is not refused because its reason is long."""
    return BeforeValidator(lambda text: f"{text[: most - 1]}…" if isinstance(text, str) and len(text) > most else text)


Label = Annotated[str, SHOW_TEXT, Field(max_length=128)]
"""A name that a program makes: of a request, an event, a holder."""

Actor = Annotated[str, SHOW_TEXT, _make_cut(128)]
"""The user or program that causes something."""

Sentence = Annotated[str, SHOW_TEXT, _make_cut(500)]
"""A reason in words."""

# Many JSON readers hold numbers as doubles: integers are exact below 2^53 only.
Int53 = Annotated[int, Field(ge=-(2**53 - 1), le=2**53 - 1)]


def _parse_host_ns(value: object) -> int:
    """An integer, or decimal text of at most 19 digits; anything else, such as a list, is a `ValueError`."""
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if isinstance(value, str) and len(value) <= 20 and value.removeprefix("-").isdecimal() and value.isascii():
        return int(value)
    raise ValueError("a host instant must be an integer, or decimal text of at most 19 digits")


HostNs = Annotated[
    int, BeforeValidator(_parse_host_ns), Field(ge=-(2**63), lt=2**63), PlainSerializer(str, when_used="json")
]
"""A host instant in ns. It can exceed 2^53 (104 days after boot), so it is sent over the bus as decimal text."""


MAX_RATIONAL_LENGTH = 200  # characters; an exact offset of an axis can be long
MAX_RATIONAL = Fraction(10**15)

# Bounded in every part, because an exponent alone can make a number of gigabytes.
_RATIONAL = re.compile(r"[-+]?(?:\d+(?:/\d+)?|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,2})?)")


def parse_rational(value: object) -> Fraction:
    """Parse an exact rational from an int, `"10000/3"` or `"0.25"`; a float counts as the decimal that it prints.

    Raises `ValueError` for any other value, and beyond ±`MAX_RATIONAL`.
    """
    # not isinstance: Fraction is an abstract number class, and isinstance costs more than the rest of this function
    if type(value) is Fraction:
        return value
    if type(value) is str:  # of a message, which has one for each axis
        return _rational(value)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError('write a number, or a fraction in quotes such as "10000/3"')
    return _rational(str(value))


def _shorten(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}…"


@lru_cache(maxsize=1024)
def _rational(text: str) -> Fraction:
    """Cached, because states repeat the same few offsets."""
    plain = text[: MAX_RATIONAL_LENGTH + 1].replace(" ", "")
    try:
        if len(text) > MAX_RATIONAL_LENGTH or _RATIONAL.fullmatch(plain) is None:
            raise ValueError(text)
        rational = Fraction(plain)
    except (ValueError, ZeroDivisionError):
        raise ValueError(f'{_shorten(text)!r} is not a number; write e.g. 400, 0.25, or "10000/3"') from None
    if not -MAX_RATIONAL <= rational <= MAX_RATIONAL:
        raise ValueError(f"{_shorten(text)} is out of range; the largest number is {float(MAX_RATIONAL):g}")
    return rational


Rational = Annotated[
    Fraction,
    BeforeValidator(parse_rational),
    PlainSerializer(str),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "pattern": r"^[-+]?[0-9.]+(/[0-9]+)?$"}]}),
]


class UnknownName(TuttiError, ValueError):
    """A reference to a name that the file does not define. `name` is the text of the reference."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(text)
        self.name = name


class Model(BaseModel):
    """A frozen value: unknown fields are refused, and no number is infinite or NaN."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
        serialize_by_alias=True,
        validate_by_name=True,
        validate_by_alias=True,
    )

    @classmethod
    def read_message(cls, payload: bytes | str) -> Self:
        """Read what a part has published or answered: fields that a newer version has added are ignored.

        Control characters in its texts become visible escapes. A request is read with `model_validate_json`, which
        refuses unknown fields: what a field asks for must not be left undone. Raises `ValidationError`."""
        raw = payload if isinstance(payload, bytes) else payload.encode("utf-8", "surrogatepass")
        return cls.model_validate_json(show_json(raw), extra="ignore")

    @classmethod
    def read_stored(cls, text: str) -> Self:
        """Read what was stored, perhaps by a version that took names with control characters: they become visible
        escapes. Raises `ValidationError`."""
        return cls.model_validate_json(show_json(text.encode("utf-8", "surrogatepass")))

    def to_json(self) -> bytes:
        """Encode for the bus: UTF-8 JSON."""
        return self.model_dump_json().encode()

    def to_plain(self) -> dict[str, Any]:
        """Convert to the JSON form in plain Python values."""
        return self.model_dump(mode="json")
