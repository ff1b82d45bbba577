"""Where the identity of a name is in a folder of keys. Nothing is made here, so that `tutti[keys]` is not needed."""

from pathlib import Path

from orchestrator.keys.names import Role
from orchestrator.keys.register import read_register
from orchestrator.model.errors import Refusal

IDENTITIES = "identities"


def find_identity_folder(keys: Path, role: Role, name: str | None = None) -> Path:
    """The folder of the identity of a name; without `name`, of the only one with that role. A folder without others in
    it is an identity itself.

    Raises `Refusal`, code `no-keys` or `which-key`.
    """
    folder = keys / IDENTITIES
    if not folder.is_dir():
        return keys
    entries = read_register(keys).names.items()
    found_entries = [
        subject
        for subject, entry in entries
        if entry.role == role and name in (None, entry.name) and not entry.revoked and (folder / subject).is_dir()
    ]
    if not found_entries:
        identity_text = f"{role}-{name}" if name else f"of the role {role}"
        raise Refusal(
            "no-keys", f"{keys} has no identity {identity_text}", "see `tutti keys ls`; add it: `tutti keys add-…`"
        )
    if len(found_entries) > 1:
        text = f"{keys} has several identities of the role {role}: {', '.join(found_entries)}"
        raise Refusal("which-key", text, f"give the folder of one: {folder / found_entries[0]}")
    return folder / found_entries[0]
