"""The certificate of a server of OPC UA: what its clients check."""

import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID

from orchestrator.cli.keys.keys import keys
from orchestrator.keys.opcua import add_opcua
from orchestrator.model.errors import Refusal

NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)


def test_it_is_self_signed_rsa_with_its_uri_and_uses(tmp_path: Path) -> None:
    expires = add_opcua(tmp_path / "opcua", "lab", NOW, 30, ("lab-pc", "192.0.2.1"))
    assert expires == NOW + timedelta(days=30)
    certificate = x509.load_der_x509_certificate((tmp_path / "opcua/cert.der").read_bytes())
    certificate.verify_directly_issued_by(certificate)
    public = certificate.public_key()
    assert isinstance(public, RSAPublicKey) and public.key_size == 2048
    key = load_pem_private_key((tmp_path / "opcua/key.pem").read_bytes(), None)
    assert key.public_key() == public
    assert certificate.not_valid_before_utc < NOW
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.UniformResourceIdentifier) == ["urn:tutti:lab"]
    assert names.get_values_for_type(x509.DNSName) == ["lab-pc"]
    assert [str(address) for address in names.get_values_for_type(x509.IPAddress)] == ["192.0.2.1"]
    usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
    assert usage.digital_signature and usage.content_commitment and usage.key_encipherment and usage.data_encipherment
    uses = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert set(uses) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in (tmp_path / "opcua").iterdir()}
    assert modes == {"cert.der": 0o600, "key.pem": 0o600, "trusted": 0o700}


def test_one_that_clients_know_is_not_replaced(tmp_path: Path) -> None:
    add_opcua(tmp_path, "lab", NOW, 30, ())
    known = (tmp_path / "cert.der").read_bytes()
    with pytest.raises(Refusal, match="is no address of a computer"):
        add_opcua(tmp_path / "other", "lab", NOW, 30, ("not a name",))
    with pytest.raises(Refusal, match="has a certificate already"):
        add_opcua(tmp_path, "lab", NOW, 30, ())
    assert (tmp_path / "cert.der").read_bytes() == known


def test_the_command_makes_it_beside_the_identities(tmp_path: Path) -> None:
    folder = str(tmp_path / "keys")
    runner = CliRunner()
    assert runner.invoke(keys, ["init", "--keys", folder, "--fleet", "lab"]).exit_code == 0
    result = runner.invoke(keys, ["add-opcua", "--keys", folder, "--address", "lab-pc"])
    assert result.exit_code == 0, result.output
    assert "urn:tutti:lab, until" in result.output
    assert (tmp_path / "keys/identities/opcua-server/trusted").is_dir()
    wrong = runner.invoke(keys, ["add-opcua", "other", "--keys", folder, "--address", "not a name"])
    assert wrong.exit_code == 2 and not (tmp_path / "keys/identities/opcua-other").exists()
