"""Which role may do what: one table for the page, for programs and for the tests.

The gateway enforces it for each verb; the page only mirrors it. Reading, and stopping, is for every role that is signed
in: a stop must never wait for a right.
"""

from typing import get_args

from orchestrator.bus.service_verbs import CONTROLLER_VERBS, SERVICE_VERBS, UserRole

Role = UserRole
ROLES: tuple[Role, ...] = get_args(Role)
"""Each role may do what those before it may. Jobs of a proposer wait for the approval of an operator."""

_GATEWAY_VERBS: dict[str, Role] = {
    "estop": "viewer",
    "check-job": "proposer",
    "work": "operator",
    "reset": "operator",
    "check-fleet": "operator",
}
LEAST_ROLES: dict[str, Role] = {
    **{name: verb.least_role for name, verb in (SERVICE_VERBS | CONTROLLER_VERBS).items()},
    **_GATEWAY_VERBS,
}
"""The least role for each verb: those of `svc/{verb}`, of controllers, and of the gateway itself."""


def may(role: Role, verb: str) -> bool:
    """Whether a role has the right to use a verb; of an unknown verb, none has."""
    least = LEAST_ROLES.get(verb)
    return least is not None and ROLES.index(role) >= ROLES.index(least)


def list_rights(role: Role) -> list[str]:
    """The verbs that a role may use, sorted."""
    return sorted(verb for verb in LEAST_ROLES if may(role, verb))
