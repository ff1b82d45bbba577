"""The identity of a session: a folder with its certificate, its key, and the certificate of the fleet's authority.

It is checked before a router gets it, because a router closes without a reason. The check is the handshake that a
router makes, in memory, with the standard library; so nothing but that is needed where no keys are made.
"""

import os
import ssl
import stat
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from orchestrator.bus.handshake import NO_CHECK_TIME, name_reason, read_instant, shake_hands
from orchestrator.model.errors import TuttiError
from orchestrator.model.files.private_files import HAS_MODES

AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE = "ca.pem", "cert.pem", "key.pem"
VARIABLE = "TUTTI_IDENTITY"
"""The environment variable with the folder; processes that a command starts get it in this way."""

_UNKNOWN_ISSUER = frozenset({7, 18, 19, 20, 21})  # X509_V_ERR_…: signature, self-signed, issuer not found


class BadIdentity(TuttiError, ValueError):
    """A session has no usable identity. The text says what is wrong with it, and what to do."""


@dataclass(frozen=True, slots=True)
class Identity:
    """folder: with the three files. common_name: of the certificate, e.g. `host-lab3.2`. begins, expires: when it
    counts."""

    folder: Path
    common_name: str
    begins: datetime
    expires: datetime

    @property
    def authority(self) -> Path:
        return self.folder / AUTHORITY_FILE

    @property
    def certificate(self) -> Path:
        return self.folder / CERTIFICATE_FILE

    @property
    def key(self) -> Path:
        return self.folder / KEY_FILE

    def require_valid(self, now: datetime) -> None:
        """Raises `BadIdentity` before and after its time."""
        if now >= self.expires:
            text = f"the certificate of {self.common_name} has expired on {self.expires:%Y-%m-%d %H:%M} UTC"
            raise BadIdentity(f"{text} ({self.certificate}); renew it: `tutti keys renew`, and copy the folder again")
        if now < self.begins:
            text = f"the certificate of {self.common_name} counts from {self.begins:%Y-%m-%d %H:%M} UTC only"
            raise BadIdentity(f"{text}, and this computer has {now:%Y-%m-%d %H:%M}; set its clock")


def find_identity() -> Path | None:
    """The folder that the environment names."""
    folder = os.environ.get(VARIABLE, "")
    return Path(folder) if folder else None


def find_session_identity(endpoint: str = "") -> Identity | None:
    """The identity that sessions of this process have; None where they have none. endpoint: of the bus, if known."""
    folder = find_identity()
    if folder is None or (endpoint and "tls/" not in endpoint):
        return None
    try:
        return read_identity(folder)
    except BadIdentity:
        return None


def read_identity(folder: Path) -> Identity:
    """Read the identity in a folder. Raises `BadIdentity` where a file is missing, unreadable, or open to other users,
    and for a certificate of another authority or another key; an expired one is returned."""
    for name in (AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE):
        path = folder / name
        try:
            mode = path.stat().st_mode
        except OSError as error:
            text = f"{path}: {error.strerror}; an identity is the folder that `tutti keys add-…` makes"
            raise BadIdentity(text) from None
        if HAS_MODES and name == KEY_FILE and stat.S_IMODE(mode) & 0o077:
            raise BadIdentity(f"{path} can be read by other users; `chmod 600 {path}`")
    certificate = _shake_hands(folder)
    try:
        subject = dict(pair for names in certificate["subject"] for pair in names)
        return Identity(
            folder, subject["commonName"], read_instant(certificate["notBefore"]), read_instant(certificate["notAfter"])
        )
    except KeyError as error:
        raise BadIdentity(f"{folder / CERTIFICATE_FILE} has no {error.args[0]}; make it by `tutti keys`") from None


def _shake_hands(folder: Path) -> dict[str, Any]:
    """Let a server in this process verify the certificate as a client's, and return what it says. Raises
    `BadIdentity`."""
    client, server = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    client.check_hostname = False
    client.verify_mode = ssl.CERT_NONE
    server.verify_mode = ssl.CERT_REQUIRED
    server.verify_flags |= NO_CHECK_TIME
    certificate, key = folder / CERTIFICATE_FILE, folder / KEY_FILE
    try:
        server.load_verify_locations(folder / AUTHORITY_FILE)
    except (OSError, ssl.SSLError) as error:
        raise BadIdentity(f"{folder / AUTHORITY_FILE} is no certificate: {name_reason(error)}") from None
    try:
        for context in (client, server):
            context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        text = f"{certificate} and {key} cannot be used together: {name_reason(error)}"
        raise BadIdentity(f"{text}; copy the whole folder again") from None
    try:
        return shake_hands(client, server)[1]
    except ssl.SSLCertVerificationError as error:
        raise BadIdentity(_explain(folder, error)) from None
    except ssl.SSLError as error:
        raise BadIdentity(f"{certificate} cannot be used: {name_reason(error)}") from None


def _explain(folder: Path, error: ssl.SSLCertVerificationError) -> str:
    certificate = folder / CERTIFICATE_FILE
    if error.verify_code in _UNKNOWN_ISSUER:
        return f"{certificate} is of another authority than {folder / AUTHORITY_FILE}; copy the whole folder again"
    return f"{certificate} cannot be used by a session: {error.verify_message}; make it by `tutti keys`"
