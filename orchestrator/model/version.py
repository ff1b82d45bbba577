"""Versions that parts state when they connect: of Tutti, and of the messages on the bus.

The protocol version is `major.minor`. A minor one adds: fields with a default, verbs, keys. Parts that are one minor
version apart work together; a reader ignores fields that it does not know. A part that is further apart, of another
major version, or that states none because it is older than 1.5, is refused by name.
"""

from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, NamedTuple

from pydantic import Field

from orchestrator.model.errors import Refusal

OTHER_VERSION = "other-version"
"""Code of a refusal to work together with a part of another version."""

ProtocolText = Annotated[str, Field(pattern=r"^([0-9]{1,4}\.[0-9]{1,4})?$")]
"""A protocol version as parts state it; empty: the part is older than this statement."""


class ProtocolVersion(NamedTuple):
    """A version of the messages on the bus."""

    major: int
    minor: int

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}"


PROTOCOL = ProtocolVersion(1, 6)
"""That of this Tutti. The minor one rises with each release that adds to the messages, the major one when a message of
before can no longer be read. `tests/compat` has the messages of each."""


@cache
def find_own_version() -> str:
    """The version of the Tutti that runs here; `unknown` where it is not installed as a package."""
    try:
        return version("tutti")
    except PackageNotFoundError:
        return "unknown"


class PartVersion(NamedTuple):
    """What a part states about itself. Both are empty for one that is older than this statement."""

    tutti: str
    protocol: str

    def __str__(self) -> str:
        return f"Tutti {self.tutti or 'before 0.5'}, protocol {self.protocol or 'before 1.5'}"


def find_own_part() -> PartVersion:
    """What each part that runs here states."""
    return PartVersion(find_own_version(), str(PROTOCOL))


def works_with(protocol: str, own: ProtocolVersion = PROTOCOL) -> bool:
    """Whether parts with these protocols work together. protocol: a `ProtocolText`."""
    if not protocol:
        return False
    major, _, minor = protocol.partition(".")
    return int(major) == own.major and abs(int(minor) - own.minor) <= 1


def require_version(other: PartVersion, name: str, own_name: str) -> None:
    """Raises `Refusal` unless a part and this one work together. name, own_name: of both, for people."""
    if works_with(other.protocol):
        return
    numbers = tuple(map(int, other.protocol.split("."))) if other.protocol else (0, 0)
    older = name if numbers < PROTOCOL else own_name
    raise Refusal(
        OTHER_VERSION,
        f"{name} has {other}; {own_name} has {find_own_part()}: they are more than one minor version apart",
        f"update Tutti on the computer of {older}, and start it again",
    )
