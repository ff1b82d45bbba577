"""Names, register, folder of keys, identities: what counts, and what is said about what does not."""

import re
import shutil
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from orchestrator.bus.endpoint import BadEndpoint, describe_openness, is_private, split_endpoints
from orchestrator.bus.expiry import describe_expiry, find_priority
from orchestrator.bus.identity import VARIABLE, BadIdentity, read_identity
from orchestrator.bus.zenoh.own_alarms import find_own_alarms
from orchestrator.keys.folder import KeyFolder
from orchestrator.keys.names import KeyName, parse_common_name
from orchestrator.keys.register import read_register
from orchestrator.model.errors import Refusal

NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)


@pytest.fixture
def made(tmp_path: Path) -> KeyFolder:
    folder = KeyFolder(tmp_path / "keys")
    folder.init("lab", NOW, 3650)
    return folder


@pytest.mark.parametrize("text", ["host-lab3.2", "estop-button-door-1.10", "viewer-a.1"])
def test_common_names_are_parsed_as_they_are_written(text: str) -> None:
    assert str(parse_common_name(text)) == text


@pytest.mark.parametrize("text", ["host-lab3", "host-lab3.0", "host-.1", "guest-a.1", "host-Lab.1", "host-a.1\n", ""])
def test_other_common_names_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=re.escape("ROLE-NAME.GENERATION")):
        parse_common_name(text)


def test_only_the_newest_generation_counts_and_a_number_is_never_used_twice(made: KeyFolder) -> None:
    made.add("host", "lab3", NOW)
    made.renew("host-lab3", NOW)
    assert [str(each) for each in read_register(made.folder).admitted()] == ["host-lab3.2"]
    with pytest.raises(Refusal, match=r"host-lab3\.2 exists already"):
        made.add("host", "lab3", NOW)
    made.revoke("host-lab3")
    assert read_register(made.folder).admitted() == []
    with pytest.raises(Refusal, match="host-lab3 is revoked"):
        made.renew("host-lab3", NOW)
    assert made.add("host", "lab3", NOW).key_name == KeyName("host", "lab3", 3)
    with pytest.raises(Refusal, match="no certificate for host-lab4; there are: host-lab3"):
        made.revoke("host-lab4")


def test_keys_are_for_their_owner_alone_and_a_router_gets_the_register(made: KeyFolder) -> None:
    made.add("router", "main", NOW, addresses=("localhost",))
    made.add("viewer", "anna", NOW)
    for path in (made.folder, *made.folder.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path
    assert read_register(made.identity("router-main")) == read_register(made.folder)
    assert sorted(path.name for path in made.identity("viewer-anna").iterdir()) == ["ca.pem", "cert.pem", "key.pem"]


def test_what_cannot_be_made_is_refused(made: KeyFolder, tmp_path: Path) -> None:
    with pytest.raises(Refusal, match="has an authority already"):
        made.init("lab", NOW, 1)
    with pytest.raises(Refusal, match="no address of a computer"):
        made.add("router", "main", NOW, addresses=("lab pc:7447",))
    with pytest.raises(Refusal, match="is no folder"):
        KeyFolder(tmp_path / "none").add("viewer", "anna", NOW)
    with pytest.raises(Refusal, match="the authority has ended"):
        made.add("viewer", "anna", NOW + timedelta(days=3651))
    (made.folder / "ca.key.pem").unlink()
    with pytest.raises(Refusal, match="only where the authority is"):
        made.add("viewer", "anna", NOW)
    assert read_register(made.folder).names == {}


def test_a_certificate_ends_no_later_than_its_authority(made: KeyFolder) -> None:
    assert made.add("viewer", "anna", NOW, days=9999).expires() == NOW + timedelta(days=3650)


def test_an_identity_states_its_name_and_its_time(made: KeyFolder) -> None:
    made.add("viewer", "anna", NOW, days=2)
    identity = read_identity(made.identity("viewer-anna"))
    assert (identity.common_name, identity.expires) == ("viewer-anna.1", NOW + timedelta(days=2))
    identity.require_valid(NOW)
    with pytest.raises(BadIdentity, match=r"viewer-anna\.1 has expired on 2026-06-03 12:00 UTC .* renew it"):
        identity.require_valid(NOW + timedelta(days=2))
    with pytest.raises(BadIdentity, match=r"counts from .* set its clock"):
        identity.require_valid(NOW - timedelta(days=1))


def test_an_identity_that_cannot_be_used_is_named_with_its_fault(made: KeyFolder, tmp_path: Path) -> None:
    made.add("viewer", "anna", NOW)
    other = KeyFolder(tmp_path / "other")
    other.init("lab", NOW, 3650)
    other.add("viewer", "anna", NOW)
    anna, stranger = made.identity("viewer-anna"), other.identity("viewer-anna")
    shutil.copy(made.folder / "ca.pem", stranger / "ca.pem")
    with pytest.raises(BadIdentity, match=r"cert\.pem is of another authority"):
        read_identity(stranger)
    shutil.copy(anna / "cert.pem", stranger / "cert.pem")
    with pytest.raises(BadIdentity, match="cannot be used together: key values mismatch"):
        read_identity(stranger)
    (anna / "key.pem").chmod(0o640)
    with pytest.raises(BadIdentity, match="can be read by other users; `chmod 600"):
        read_identity(anna)
    (anna / "key.pem").unlink()
    with pytest.raises(BadIdentity, match=r"key\.pem: No such file"):
        read_identity(anna)
    (anna / "key.pem").write_text("no key")
    (anna / "key.pem").chmod(0o600)
    with pytest.raises(BadIdentity, match="cannot be used together"):
        read_identity(anna)


def test_a_process_raises_an_alarm_for_its_own_certificate(made: KeyFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    made.add("host", "lab3", NOW, days=7)
    monkeypatch.setenv(VARIABLE, str(made.identity("host-lab3")))
    (alarm,) = find_own_alarms("tls/lab-pc:7447", NOW)
    assert (alarm.kind, alarm.subject, alarm.priority) == ("certificate", "host-lab3.1", "medium")
    assert "host-lab3.1 ends in 7 days (2026-06-08 12:00 UTC)" in alarm.text
    assert find_own_alarms("tcp/127.0.0.1:7447", NOW) == []  # it uses no certificate there
    (alarm,) = find_own_alarms("tcp/192.0.2.1:7447", NOW)
    assert (alarm.kind, alarm.priority) == ("open-bus", "high")


def test_endpoints_say_what_reaches_them() -> None:
    private = ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", "tcp/localhost:1", "unixsock-stream/run/bus"]
    assert all(map(is_private, private))
    assert describe_openness(",".join([*private, "tls/0.0.0.0:7447"])) == ""
    assert "at tcp/0.0.0.0:7447 has no TLS" in describe_openness("tcp/127.0.0.1:1,tcp/0.0.0.0:7447")
    assert not is_private("tcp/127.0.0.1.example.org:7447")
    for wrong in ("tls/a:1,", "tls/a:1,tcp/b", "tls/a:1, tls/b:2", ",".join(["tls/a:1"] * 9)):
        with pytest.raises(BadEndpoint):
            split_endpoints(wrong)


def test_the_end_of_a_certificate_is_announced_three_times() -> None:
    days = (31, 30, 8, 7, 2, 1, 0, -1)
    found = [find_priority(NOW + timedelta(days=each), NOW) for each in days]
    assert found == [None, "low", "low", "medium", "medium", "high", "high", "high"]
    words = [describe_expiry(NOW + timedelta(days=each), NOW) for each in (31, 6, 1, 0)]
    assert words == ["valid", "ends in 6 days", "ends in 24 h", "expired"]
