"""What it needs to serve the page on an address that other computers reach: TLS, names, and users."""

from datetime import datetime

from orchestrator.gateway.access.users import UserFile
from orchestrator.gateway.certificate import WebCertificate
from orchestrator.model.errors import Refusal

OWN_ADDRESSES = ("127.0.0.1", "localhost", "::1")
"""On which no other computer reaches this one."""
OWN_NAMES = ("127.0.0.1", "localhost", "[::1]")
"""The same as they stand in an address of a page."""


def is_own_address(address: str) -> bool:
    """Whether no other computer reaches a page that is served there."""
    return address in OWN_ADDRESSES


def list_names_beyond(certificate: WebCertificate) -> tuple[str, ...]:
    """The names of a certificate by which other computers reach it."""
    return tuple(name for name in certificate.names if name not in OWN_NAMES)


def require_reach(address: str, certificate: WebCertificate | None, users: UserFile, now: datetime) -> None:
    """Raises `Refusal` where other computers would reach `address` without all that it needs: codes `not-own-address`,
    `bad-certificate`, `no-users`, and those of the file of users."""
    if is_own_address(address):
        return
    start = f"the page is not served on {address[:100]}"
    if certificate is None:
        text = f"{start}: other computers would reach it without TLS"
        remedy = (
            "give the keys of the fleet (`tutti keys add-gateway`, --keys), or another certificate (--web-cert); or "
        )
        remedy += "serve it on 127.0.0.1, and reach it by `ssh -L 8080:127.0.0.1:8080`"
        raise Refusal("not-own-address", text, remedy)
    renewal = "renew it: `tutti keys renew gateway-NAME`, or with its authority"
    if now >= certificate.expires:
        text = f"{start}: its certificate {certificate.file} has expired on {certificate.expires:%Y-%m-%d %H:%M} UTC"
        raise Refusal("bad-certificate", text, renewal)
    if now < certificate.begins:
        text = f"{start}: its certificate {certificate.file} counts from {certificate.begins:%Y-%m-%d %H:%M} UTC only"
        raise Refusal("bad-certificate", text, "set the clock of this computer")
    if not list_names_beyond(certificate):
        text = f"{start}: its certificate {certificate.file} has no name or address of this computer in subjectAltName"
        raise Refusal("bad-certificate", text, "`tutti keys add-gateway NAME --address …`: what browsers will open")
    if not users.load().users:
        text = f"{start}: the fleet has no users, and each computer that reaches it would be an operator"
        raise Refusal("no-users", f"{text} ({users.path})", "add one: `tutti user add NAME --role operator`")
