"""The authority of a fleet, and the certificates that it issues: X.509 (RFC 5280), EC P-256, signed with SHA-256."""

import ipaddress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from orchestrator.model.errors import Refusal

AUTHORITY_DAYS = 3650
CERTIFICATE_DAYS = 397
SKEW = timedelta(minutes=5)  # a certificate counts from a little before now: clocks of other computers may be behind


@dataclass(frozen=True, slots=True)
class IssuedKey:
    """A certificate and its private key, both PEM. expires: when it ends."""

    certificate: bytes
    key: bytes
    expires: datetime


class Authority:
    """Issues certificates. Made by `make_authority` or `load_authority`."""

    def __init__(self, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
        self._certificate = certificate
        self._key = key

    @property
    def certificate(self) -> bytes:
        """Its certificate, PEM."""
        return self._certificate.public_bytes(Encoding.PEM)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of its certificate, hex."""
        return self._certificate.fingerprint(hashes.SHA256()).hex()

    def issue(self, common_name: str, now: datetime, days: float, addresses: tuple[str, ...] = ()) -> IssuedKey:
        """Issue a certificate for `common_name`, for `days` from now, but no longer than the authority's own.

        addresses: host names and IP addresses; with any it is also a server's. Raises `Refusal`, code `bad-address`,
        and `authority-expired`.
        """
        expires = min(now + timedelta(days=days), self._certificate.not_valid_after_utc)
        if expires <= now:
            text = f"the authority has ended on {expires:%Y-%m-%d}"
            raise Refusal("authority-expired", text, "make a new one: `tutti keys init` in another folder")
        key = ec.generate_private_key(ec.SECP256R1())
        builder = _begin(common_name, self._certificate.subject, key.public_key(), now - SKEW, expires)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if addresses:
            uses.append(ExtendedKeyUsageOID.SERVER_AUTH)
            names = x509.SubjectAlternativeName([parse_address(address) for address in addresses])
            builder = builder.add_extension(names, critical=False)
        builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        builder = builder.add_extension(_make_usage(authority=False), critical=True)
        issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key())
        builder = builder.add_extension(issuer, critical=False)
        signed_certificate = builder.sign(self._key, hashes.SHA256())
        return IssuedKey(
            signed_certificate.public_bytes(Encoding.PEM), encode_key(key), signed_certificate.not_valid_after_utc
        )


def make_authority(fleet: str, now: datetime, days: float = AUTHORITY_DAYS) -> tuple[Authority, bytes]:
    """Make the authority of a fleet; returns it, and its private key as PEM."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = f"authority of fleet {fleet}"[:64]
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = _begin(name, subject, key.public_key(), now - SKEW, now + timedelta(days=days))
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_make_usage(authority=True), critical=True)
    builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    return Authority(builder.sign(key, hashes.SHA256()), key), encode_key(key)


def load_authority(certificate: bytes, key: bytes) -> Authority:
    """The authority of two PEM texts. Raises `Refusal`, code `bad-keys`, if they cannot be read, or are not a pair."""
    try:
        loaded_certificate, private = x509.load_pem_x509_certificate(certificate), load_pem_private_key(key, None)
    except (ValueError, TypeError) as error:
        raise Refusal("bad-keys", f"the authority cannot be read: {error}", "restore it from a backup") from None
    if not isinstance(private, ec.EllipticCurvePrivateKey) or loaded_certificate.public_key() != private.public_key():
        raise Refusal("bad-keys", "certificate and key of the authority are no pair", "restore both from a backup")
    return Authority(loaded_certificate, private)


def _begin(
    common_name: str, issuer: x509.Name, key: ec.EllipticCurvePublicKey, begins: datetime, expires: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)]))
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins.astimezone(UTC))
        .not_valid_after(expires.astimezone(UTC))
    )


def _make_usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=authority,
        crl_sign=authority,
        encipher_only=False,
        decipher_only=False,
    )


def parse_address(text: str) -> x509.GeneralName:
    """An IP address, or the name of a computer. Raises `Refusal`, code `bad-address`."""
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        pass
    labels = text.split(".")
    if len(text) > 253 or not all(label.replace("-", "").isalnum() and label.isascii() for label in labels):
        text = f"{text[:80]!r} is no address of a computer"
        raise Refusal("bad-address", text, "give a host name or an IP address, without a port")
    return x509.DNSName(text)


def encode_key(key: ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey) -> bytes:
    """A private key as PEM."""
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
