"""Which role may do what: one table for the page, for programs and for the tests.

The gateway enforces it for each verb; the page only mirrors it. Reading, and stopping, is for every role that is signed
in: a stop must never wait for a right.
"""

from typing import Literal, get_args

from orchestrator.bus.service_verbs import VIEW_VERBS

Role = Literal["viewer", "proposer", "operator", "maintainer"]
ROLES: tuple[Role, ...] = get_args(Role)
"""Each role may do what those before it may."""

LEAST_ROLES: dict[str, Role] = {
    **dict.fromkeys(VIEW_VERBS, "viewer"),
    "stop": "viewer",
    "estop": "viewer",
    # Jobs of a proposer wait for the approval of an operator.
    "submit": "proposer",
    "put-points": "proposer",
    "dry-run": "proposer",
    "check-job": "proposer",
    "approve": "operator",
    "cancel": "operator",
    "retry": "operator",
    "hold": "operator",
    "release": "operator",
    "reorder": "operator",
    "pause": "operator",
    "resume": "operator",
    "override": "operator",
    "start-queue": "operator",
    "stop-queue": "operator",
    "acknowledge": "operator",
    "shelve": "operator",
    "save-position": "operator",
    "acquire-axes": "operator",
    "release-axes": "operator",
    "jog": "operator",
    "work": "operator",
    "reset": "operator",
    "check-fleet": "operator",
    "check-wiring": "operator",
    "remove-position": "maintainer",
    "prune": "maintainer",
    "reload": "maintainer",
    "repair-epoch": "maintainer",
    "forget": "maintainer",
    "raw": "maintainer",
}
"""The least role for each verb: those of `svc/{verb}`, of controllers, and of the gateway itself."""


def may(role: Role, verb: str) -> bool:
    """Whether a role has the right to use a verb; of an unknown verb, none has."""
    least = LEAST_ROLES.get(verb)
    return least is not None and ROLES.index(role) >= ROLES.index(least)


def list_rights(role: Role) -> list[str]:
    """The verbs that a role may use, sorted."""
    return sorted(verb for verb in LEAST_ROLES if may(role, verb))
