"""The certificate of the page: read and checked before it is served, with the standard library alone."""

import ipaddress
import ssl
from dataclasses import dataclass
from datetime import datetime
from hashlib import sha256
from pathlib import Path

from orchestrator.bus.handshake import NO_CHECK_TIME, Peer, name_reason, read_instant, shake_hands
from orchestrator.model.errors import Refusal


@dataclass(frozen=True, slots=True)
class WebCertificate:
    """file, key: PEM. names: of its subjectAltName, as they stand in an address of a page. digest: SHA-256 of
    the file. begins, expires: when it counts."""

    file: Path
    key: Path
    names: tuple[str, ...]
    digest: str
    begins: datetime
    expires: datetime

    def make_context(self) -> ssl.SSLContext:
        """For a server: TLS 1.2 and above. Raises `Refusal`."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        self.load_into(context)
        return context

    def load_into(self, context: ssl.SSLContext) -> None:
        """Let a server use it for connections from now on. Raises `Refusal`."""
        _load_pair(context, self.file, self.key)


def read_web_certificate(file: Path, key: Path) -> WebCertificate:
    """Read a certificate, perhaps with its chain, and its key. Patterns among its names (`*.example.org`) are left out:
    a page that any computer of a domain could stand for is none of this one. An expired one is returned.

    Raises `Refusal`, code `bad-certificate`: unreadable, no pair, or not for servers.
    """
    client, server = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    client.check_hostname = False
    # Whichever authority has issued it: here it is verified by itself.
    client.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN | NO_CHECK_TIME
    _load_pair(server, file, key)
    try:
        client.load_verify_locations(file)
        fields = shake_hands(client, server)[0]
        return WebCertificate(
            file=file,
            key=key,
            names=_list_names(fields),
            digest=sha256(file.read_bytes()).hexdigest(),
            begins=read_instant(fields["notBefore"]),
            expires=read_instant(fields["notAfter"]),
        )
    except ssl.SSLCertVerificationError as error:
        text = f"the certificate {file} cannot be used: {error.verify_message}"
        raise Refusal("bad-certificate", text, "give one for servers; of the fleet: `tutti keys add-gateway`") from None
    except (OSError, ssl.SSLError) as error:
        raise _refuse_pair(file, key, error) from None


def _load_pair(context: ssl.SSLContext, file: Path, key: Path) -> None:
    try:
        # Without a password: one that is asked for would be waited for at the terminal.
        context.load_cert_chain(file, key, password="")
    except (OSError, ssl.SSLError) as error:
        raise _refuse_pair(file, key, error) from None


def _refuse_pair(file: Path, key: Path, error: Exception) -> Refusal:
    text = f"the certificate {file} cannot be used with the key {key}: {name_reason(error)}"
    return Refusal("bad-certificate", text, "give a certificate and its key, without a password, as PEM files")


def _list_names(found: Peer) -> tuple[str, ...]:
    names: list[str] = []
    for kind, value in found.get("subjectAltName", ()):
        if kind == "DNS" and "*" not in value:
            names.append(value.lower())
        elif kind == "IP Address":
            address = ipaddress.ip_address(value)
            names.append(f"[{address}]" if address.version == 6 else str(address))
    return tuple(dict.fromkeys(names))
