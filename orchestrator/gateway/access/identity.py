"""The user, or the program, behind a request to the gateway."""

from dataclasses import dataclass
from typing import Literal

from orchestrator.gateway.access.roles import LEAST_ROLES, Role, list_rights, may
from orchestrator.model.errors import Refusal

Access = Literal["open", "cookie", "token"]


@dataclass(frozen=True, slots=True)
class Identity:
    """An authenticated request, or socket.

    user: empty where the fleet has no users. access: `open`: there are no users, and whatever reaches this machine's
    own address is an operator. address: of the client. csrf: what requests that change something must repeat in a
    header, if the access is a cookie. verbs: a token's own limits; None: all that its role allows.
    """

    user: str
    role: Role
    address: str
    access: Access
    csrf: str = ""
    token: str = ""
    verbs: frozenset[str] | None = None

    @property
    def actor(self) -> str:
        """The name for journals and logs."""
        name = self.user or self.role
        return f"{name}/{self.token}@{self.address}" if self.token else f"{name}@{self.address}"

    def may(self, verb: str) -> bool:
        """Whether it may use a verb."""
        return may(self.role, verb) and (self.verbs is None or verb in self.verbs or verb in ("stop", "estop"))

    def require_right(self, verb: str) -> None:
        """Raises `Refusal`, code `not-allowed`."""
        if not self.may(verb):
            least = LEAST_ROLES.get(verb, "maintainer")
            text = f"{self.user or self.role} has the role {self.role}, and {verb} needs {least}"
            if may(self.role, verb):
                text = f"token {self.token} is not for {verb}"
            raise Refusal("not-allowed", text, "ask a user with that role; `tutti user ls` lists them")

    def list_rights(self) -> list[str]:
        """The verbs that it may use."""
        return [verb for verb in list_rights(self.role) if self.may(verb)]
