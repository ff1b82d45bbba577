"""The folder of a fleet's keys.

    ca.pem, ca.key.pem    the authority; its key never leaves this folder
    register.json         which names count
    identities/host-lab3  what the owner of a name needs: ca.pem, cert.pem, key.pem; a router also the register

An identity is made here and handed over as a folder. Everything is for its owner alone (folders 0700, files 0600).
"""

import os
from collections.abc import Generator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from orchestrator.bus.identity import AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE
from orchestrator.clock.utc import format_rfc3339
from orchestrator.keys.authority import CERTIFICATE_DAYS, Authority, load_authority, make_authority
from orchestrator.keys.names import KeyName, Role
from orchestrator.keys.places import IDENTITIES
from orchestrator.keys.register import REGISTER_FILE, Register, RegisterEntry, read_register, write_register
from orchestrator.model.errors import Refusal
from orchestrator.model.files.locks import lock_file
from orchestrator.model.files.private_files import (
    make_private_folder,
    open_private_file,
    read_private_file,
    replace_private_file,
)

AUTHORITY_KEY_FILE = "ca.key.pem"
_LOCK = "lock"


class KeyFolder:
    """The folder of the authority; every change rewrites the register, and its copies in the folders of routers.

    Methods raise `Refusal`, `UnsafePath` and `OSError`.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def init(self, fleet: str, now: datetime, days: float) -> Register:
        """Make the authority. Raises `Refusal`, code `key-exists`, where there is one."""
        make_private_folder(self.folder)
        with self._locked():
            if (self.folder / AUTHORITY_KEY_FILE).exists() or (self.folder / REGISTER_FILE).exists():
                text = f"{self.folder} has an authority already"
                raise Refusal("key-exists", text, "use it, or give another folder: --keys")
            parts, key = make_authority(fleet, now, days)
            register = Register(fleet=fleet, authority=parts.fingerprint)
            replace_private_file(self.folder / AUTHORITY_KEY_FILE, key)
            replace_private_file(self.folder / AUTHORITY_FILE, parts.certificate)
            write_register(self.folder, register)
            return register

    def add(
        self, role: Role, name: str, now: datetime, days: float = CERTIFICATE_DAYS, addresses: tuple[str, ...] = ()
    ) -> RegisterEntry:
        """Issue the first certificate of a name, or the next one after it was revoked."""
        with self._locked():
            parts = self._open()
            return self._issue(parts, parts[0].name_to_add(role, name), now, days, addresses)

    def renew(self, subject: str, now: datetime, days: float = CERTIFICATE_DAYS) -> RegisterEntry:
        """Issue the next generation of a name: the one before it counts no more, once the router has the new table."""
        with self._locked():
            parts = self._open()
            addresses = tuple(parts[0].require(subject).addresses)
            return self._issue(parts, parts[0].name_to_renew(subject), now, days, addresses)

    def revoke(self, subject: str, *, at_once: bool = False) -> RegisterEntry:
        """Take a name out of the table. at_once: routers do not wait until the fleet is at rest, but stop it."""
        with self._locked():
            changed_register = read_register(self.folder).revoke(subject, at_once=at_once)
            self._write(changed_register)
            return changed_register.require(subject)

    def identity(self, subject: str) -> Path:
        """The folder to hand over to the owner of a name."""
        return self.folder / IDENTITIES / subject

    def _open(self) -> tuple[Register, Authority]:
        register = read_register(self.folder)
        try:
            texts = [read_private_file(self.folder / file) for file in (AUTHORITY_FILE, AUTHORITY_KEY_FILE)]
        except FileNotFoundError as error:
            text = f"{error.filename} is missing: certificates can be issued only where the authority is"
            raise Refusal("no-keys", text, "give the folder that `tutti keys init` has made") from None
        return register, load_authority(*texts)

    def _issue(
        self, opened: tuple[Register, Authority], name: KeyName, now: datetime, days: float, addresses: tuple[str, ...]
    ) -> RegisterEntry:
        register, parts = opened
        issued_key = parts.issue(str(name), now, days, addresses)
        # The identity first: a name in the table without a certificate is harmless, the reverse is puzzling.
        folder = self.identity(name.subject)
        make_private_folder(folder)
        replace_private_file(folder / AUTHORITY_FILE, parts.certificate)
        replace_private_file(folder / KEY_FILE, issued_key.key)
        replace_private_file(folder / CERTIFICATE_FILE, issued_key.certificate)
        changed_register = register.admit(name, format_rfc3339(issued_key.expires), addresses)
        self._write(changed_register)
        return changed_register.require(name.subject)

    def _write(self, register: Register) -> None:
        write_register(self.folder, register)
        for subject, entry in register.names.items():
            if entry.role == "router" and self.identity(subject).is_dir():
                write_register(self.identity(subject), register)

    @contextmanager
    def _locked(self) -> Generator[None]:
        """One change at a time."""
        try:
            lock = open_private_file(self.folder / _LOCK, os.O_RDWR | os.O_CREAT)
        except FileNotFoundError:
            raise Refusal("no-keys", f"{self.folder} is no folder", "make it: `tutti keys init`") from None
        with os.fdopen(lock, "wb"):
            lock_file(lock)
            yield
