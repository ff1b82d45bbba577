"""Names in certificates: `ROLE-NAME.GENERATION`, e.g. `host-lab3.2`.

The router compares whole names. So a generation is part of the name: a renewed certificate has another name, and the
one before it is not in the table any more.
"""

import re
from dataclasses import dataclass
from typing import Literal, cast, get_args

Role = Literal[
    "coordinator", "estop-button", "gateway", "host", "maintainer", "operator", "recorder", "router", "viewer"
]
ROLES: tuple[Role, ...] = get_args(Role)
USER_ROLES: tuple[Role, ...] = ("operator", "maintainer", "viewer", "recorder", "estop-button", "gateway")
"""Roles without a command of their own to add them."""

MAX_COMMON_NAME = 64  # characters (RFC 5280, ub-common-name)
MAX_NAME = 40  # leaves room for the longest role and a generation of ten digits
_NAME = re.compile(rf"[a-z0-9_-]{{1,{MAX_NAME}}}")
_COMMON_NAME = re.compile(rf"({'|'.join(ROLES)})-([a-z0-9_-]{{1,{MAX_NAME}}})\.([1-9]\d{{0,9}})")


@dataclass(frozen=True, slots=True)
class KeyName:
    """One certificate's name. generation: from 1; each renewal adds one."""

    role: Role
    name: str
    generation: int

    @property
    def subject(self) -> str:
        """The name without its generation, e.g. `host-lab3`: what stays the same when it is renewed."""
        return make_subject(self.role, self.name)

    def __str__(self) -> str:
        return f"{self.subject}.{self.generation}"


def check_name(name: str) -> str:
    """Return `name`. Raises `ValueError` if it cannot be the name of a host, a user or a process."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name[:60]!r}: a name has 1 to {MAX_NAME} characters of a-z, 0-9, '_' and '-'")
    return name


def make_subject(role: Role, name: str) -> str:
    """The name without a generation. Raises `ValueError`."""
    return f"{role}-{check_name(name)}"


def parse_common_name(text: str) -> KeyName:
    """Parse the common name of a certificate. Raises `ValueError`, which shows the form."""
    match = _COMMON_NAME.fullmatch(text)
    if match is None:
        raise ValueError(f"{text[:80]!r} is not of the form ROLE-NAME.GENERATION, e.g. host-lab3.2")
    return KeyName(cast("Role", match[1]), match[2], int(match[3]))
