"""The certificate of a server of OPC UA: self-signed RSA, as OPC 10000-6, 6.2 and the profile Basic256Sha256 ask.

It is none of the fleet's authority, whose keys are EC P-256, which that profile does not know. Clients are given the
certificate itself, and the server theirs.
"""

from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from orchestrator.keys.authority import SKEW, encode_key, parse_address
from orchestrator.model.errors import Refusal
from orchestrator.model.files.private_files import make_private_folder, replace_private_file

KEY_BITS = 2048
CERTIFICATE, KEY, TRUSTED = "cert.der", "key.pem", "trusted"


def find_application_uri(fleet: str) -> str:
    """The ApplicationUri of the server of a fleet, which its certificate states."""
    return f"urn:tutti:{fleet}"


def add_opcua(folder: Path, fleet: str, now: datetime, days: float, addresses: tuple[str, ...]) -> datetime:
    """Make key, certificate and the folder for the certificates of clients in `folder`; returns when it ends.

    addresses: host names and IP addresses under which clients reach it. Raises `Refusal`, codes `key-exists` and
    `bad-address`, and `UnsafePath`, `OSError`.
    """
    if (folder / CERTIFICATE).exists():
        text = f"{folder} has a certificate already, which clients know"
        raise Refusal("key-exists", text, f"remove {CERTIFICATE} there first; then give clients the new one")
    key = rsa.generate_private_key(public_exponent=65537, key_size=KEY_BITS)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"Tutti, fleet {fleet}"[:64])])
    names = [x509.UniformResourceIdentifier(find_application_uri(fleet)), *map(parse_address, addresses)]
    expires = (now + timedelta(days=days)).astimezone(UTC)
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before((now - SKEW).astimezone(UTC))
        .not_valid_after(expires)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_make_usage(), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False
        )
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(identifier, critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(identifier), critical=False)
    )
    certificate = builder.sign(key, hashes.SHA256())
    make_private_folder(folder / TRUSTED)
    replace_private_file(folder / KEY, encode_key(key))
    replace_private_file(folder / CERTIFICATE, certificate.public_bytes(Encoding.DER))
    return certificate.not_valid_after_utc


def _make_usage() -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=True,  # non-repudiation
        key_encipherment=True,
        data_encipherment=True,
        key_agreement=False,
        key_cert_sign=True,  # it signs itself: OPC 10000-6, Table 43
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
