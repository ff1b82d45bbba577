"""The register of a fleet's certificates: which names there are, which generation of each counts, which are revoked.

It has no secrets. The router makes its access table of it; a name counts only in the generation that stands here.
"""

from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from orchestrator.keys.names import KeyName, Role, make_subject
from orchestrator.model.base import Id, Model
from orchestrator.model.errors import Refusal
from orchestrator.model.files.private_files import read_private_file, replace_private_file
from orchestrator.model.problems import describe_first_error
from orchestrator.model.queue import Utc

REGISTER_FILE = "register.json"
MAX_NAMES = 2000  # the router compares one by one when a session opens


class RegisterEntry(Model):
    """One name. generation: the one that counts. addresses: under which a router, or a gateway, is
    reached. expires_utc: of the certificate of that generation."""

    role: Role
    name: Id
    generation: int = Field(ge=1, lt=10**10)
    expires_utc: Utc
    addresses: list[str] = Field(default_factory=list[str], max_length=100)
    revoked: bool = False

    @property
    def key_name(self) -> KeyName:
        """The name in the certificate that counts."""
        return KeyName(self.role, self.name, self.generation)

    def expires(self) -> datetime:
        """When the certificate ends."""
        return datetime.fromisoformat(self.expires_utc).astimezone(UTC)


class Register(Model):
    """All names of one fleet, by subject, e.g. `host-lab3`.

    authority: SHA-256 of its certificate, hex. urgent: how many changes must not wait for a rest of the fleet."""

    schema_: Literal["tutti.register/1"] = Field(default="tutti.register/1", alias="schema")
    fleet: Id
    authority: str
    urgent: int = Field(default=0, ge=0)
    names: dict[str, RegisterEntry] = Field(default_factory=dict[str, RegisterEntry], max_length=MAX_NAMES)

    def admitted(self) -> list[KeyName]:
        """The names that the router admits, sorted."""
        names = [entry.key_name for entry in self.names.values() if not entry.revoked]
        return sorted(names, key=str)

    def require(self, subject: str) -> RegisterEntry:
        """An entry by its subject. Raises `Refusal`, code `unknown-name`."""
        entry = self.names.get(subject)
        if entry is None:
            subject_list = ", ".join(sorted(self.names)) or "none"
            text = f"there is no certificate for {subject[:80]}; there are: {subject_list}"
            raise Refusal("unknown-name", text, "see `tutti keys ls`")
        return entry

    def name_to_add(self, role: Role, name: str) -> KeyName:
        """The name of a first certificate; after a revocation, the generation behind the last one.

        Raises `Refusal`, code `key-exists`, and `ValueError` for what cannot be a name.
        """
        subject = make_subject(role, name)
        name_before = self.names.get(subject)
        if name_before is not None and not name_before.revoked:
            raise Refusal("key-exists", f"{name_before.key_name} exists already", f"`tutti keys renew {subject}`")
        return KeyName(role, name, 1 if name_before is None else name_before.generation + 1)

    def name_to_renew(self, subject: str) -> KeyName:
        """The next generation of a name. Raises `Refusal`, code `key-revoked` or `unknown-name`."""
        entry = self.require(subject)
        if entry.revoked:
            raise Refusal("key-revoked", f"{subject} is revoked", "add it again: it gets the next generation")
        return KeyName(entry.role, entry.name, entry.generation + 1)

    def admit(self, name: KeyName, expires_utc: str, addresses: tuple[str, ...] = ()) -> "Register":
        """The register in which this generation of a name counts, and no earlier one."""
        entry = RegisterEntry(
            role=name.role,
            name=name.name,
            generation=name.generation,
            expires_utc=expires_utc,
            addresses=list(addresses),
        )
        return self._with(name.subject, entry)

    def revoke(self, subject: str, *, at_once: bool = False) -> "Register":
        """The register without that name in the table. Raises `Refusal`, code `unknown-name`."""
        changed_register = self._with(subject, self.require(subject).model_copy(update={"revoked": True}))
        return changed_register.model_copy(update={"urgent": self.urgent + at_once})

    def _with(self, subject: str, entry: RegisterEntry) -> "Register":
        return self.model_copy(update={"names": {**self.names, subject: entry}})


def read_register(folder: Path) -> Register:
    """The register in a folder. Raises `Refusal`, code `no-keys` or `bad-keys`, and `UnsafePath`."""
    path = folder / REGISTER_FILE
    try:
        return Register.model_validate_json(read_private_file(path))
    except FileNotFoundError:
        text = f"{folder} has no {REGISTER_FILE}: it is not a folder of keys"
        raise Refusal("no-keys", text, "give the folder that `tutti keys init` has made, or a router's") from None
    except ValidationError as error:
        text = f"{path}: {describe_first_error(error, 'it')}"
        raise Refusal("bad-keys", text, "restore it from a backup") from None


def write_register(folder: Path, register: Register) -> None:
    """Replace the register in a folder. Raises `UnsafePath`, `OSError`."""
    replace_private_file(folder / REGISTER_FILE, register.to_json() + b"\n")
