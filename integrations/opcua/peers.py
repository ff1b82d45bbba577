"""Clients that are known by their certificates, and the certificate of the server."""

import ssl
from pathlib import Path
from typing import Any

from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions
from asyncua.server.user_managers import UserManager

from integrations.opcua.types import ua
from tutti import Refusal

CERTIFICATE, KEY, TRUSTED = "cert.der", "key.pem", "trusted"
"""As `tutti keys add-opcua` names them. In the folder of the trusted: a certificate in each file, DER or PEM."""


class TrustedPeers(UserManager):
    """The clients whose certificates are in the folder `trusted`; none else gets a session. Raises `Refusal`.

    A certificate is known as a whole, not by its issuer, and is that of the secure channel: what a client states of
    itself later does not matter.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        if not (folder / CERTIFICATE).is_file() or not (folder / KEY).is_file():
            text = f"{folder} has no {CERTIFICATE} and {KEY}"
            raise Refusal("no-certificate", text, "make them: `tutti keys add-opcua`")

    async def secure(self, server: Any) -> None:
        """Let a server sign and encrypt all, by the policies that OPC 10000-7 does not call deprecated."""
        kinds = ua.SecurityPolicyType
        server.set_security_policy(
            [kinds.Aes256Sha256RsaPss_SignAndEncrypt, kinds.Basic256Sha256_SignAndEncrypt, kinds.Basic256Sha256_Sign]
        )
        await server.load_certificate(self._folder / CERTIFICATE)
        await server.load_private_key(self._folder / KEY)
        options = CertificateValidatorOptions.EXT_VALIDATION | CertificateValidatorOptions.PEER_CLIENT
        server.set_certificate_validator(CertificateValidator(options))

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> User | None:
        """The user of a session; None refuses it. certificate: of its secure channel, DER."""
        return User(UserRole.User) if certificate in self._read_trusted() else None

    def _read_trusted(self) -> set[bytes]:
        """Read each time, so that a file counts as soon as it is there, and no more once it is gone."""
        contents = [path.read_bytes() for path in (self._folder / TRUSTED).glob("*") if path.is_file()]
        return {_make_der(content) for content in contents}


def _make_der(content: bytes) -> bytes:
    try:
        return ssl.PEM_cert_to_DER_cert(content.decode("ascii"))
    except ValueError:
        return content
