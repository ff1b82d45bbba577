"""The certificate of the page: what it is served with beyond its computer, what is refused, and its end."""

import ssl
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from orchestrator.bus.identity import CERTIFICATE_FILE, KEY_FILE
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.executor import run_inline
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.gateway.access.users import UserFile
from orchestrator.gateway.certificate import WebCertificate, read_web_certificate
from orchestrator.gateway.certificate_watch import CertificateWatch
from orchestrator.gateway.reach import require_reach
from orchestrator.keys.folder import KeyFolder
from orchestrator.keys.names import Role
from orchestrator.model.errors import Refusal
from orchestrator.model.operation.alarms import AlarmRequest
from orchestrator.model.queue import parse_utc

NOW = parse_utc("2026-06-01T12:00:00Z")
UTC_TEXT = "2026-06-01T12:00:00.000000Z"
NAMES = ("tutti.lab", "192.0.2.5", "[fe80::1]", "localhost", "127.0.0.1", "[::1]")

Make = Callable[..., WebCertificate]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    keys = KeyFolder(tmp_path / "keys")
    keys.init("lab", NOW, 3650)

    def make_certificate(
        *addresses: str, role: Role = "gateway", begins: datetime = NOW, days: float = 30
    ) -> WebCertificate:
        subject = f"{role}-page"
        try:
            keys.add(role, "page", begins, days, addresses)
        except Refusal:
            keys.renew(subject, begins, days)
        folder = keys.identity(subject)
        return read_web_certificate(folder / CERTIFICATE_FILE, folder / KEY_FILE)

    return make_certificate


def test_the_names_of_a_certificate_stand_as_in_an_address(make: Make) -> None:
    found = make(*(name.strip("[]") for name in NAMES))
    assert found.names == NAMES
    assert (found.begins, found.expires) == (NOW - timedelta(minutes=5), NOW + timedelta(days=30))
    assert found.make_context().minimum_version == ssl.TLSVersion.TLSv1_2


def test_what_is_no_certificate_for_a_page_is_refused(make: Make, tmp_path: Path) -> None:
    page = make("tutti.lab")
    with pytest.raises(Refusal, match="unsuitable certificate purpose"):
        make(role="viewer")  # without an address it is none for servers
    other = make("tutti.lab", role="router")
    with pytest.raises(Refusal, match="key values mismatch"):
        read_web_certificate(page.file, other.key)
    (tmp_path / "no.pem").write_text("nothing")
    for file in (tmp_path / "no.pem", tmp_path / "none.pem"):
        with pytest.raises(Refusal, match=r"cannot be used with the key") as refused:
            read_web_certificate(file, page.key)
        assert refused.value.code == "bad-certificate" and refused.value.remedy


def test_beyond_its_computer_a_page_needs_tls_a_name_and_users(make: Make, tmp_path: Path) -> None:
    address, users = "0.0.0.0", UserFile(tmp_path / "users.json")
    certificate = make("tutti.lab", "localhost")

    def find_refusal(given: WebCertificate | None, now: datetime = NOW) -> tuple[str, str]:
        with pytest.raises(Refusal) as refused:
            require_reach(address, given, users, now)
        assert refused.value.remedy and address in refused.value.text
        return refused.value.code, refused.value.text

    assert find_refusal(certificate)[0] == "no-users"
    users.add_user("olga", "operator", "correct horse", UTC_TEXT)
    require_reach(address, certificate, users, NOW)
    for each in ("::", "192.0.2.5", "tutti.lab", "127.0.0.1.example.org", "0.0.0.0"):
        with pytest.raises(Refusal, match=f"not served on {each}: other computers would reach it without TLS"):
            require_reach(each, None, users, NOW)
    assert "has expired on 2026-07-01 12:00 UTC" in find_refusal(certificate, certificate.expires)[1]
    assert "counts from 2026-06-01 11:55 UTC only" in find_refusal(certificate, NOW - timedelta(days=1))[1]
    assert "has no name" in find_refusal(make("localhost", "127.0.0.1", role="router"))[1]
    users.path.write_text("{")
    with pytest.raises(Refusal, match=r"users\.json"):
        require_reach(address, certificate, users, NOW)


def test_its_own_computer_needs_none_of_it(tmp_path: Path) -> None:
    for address in ("127.0.0.1", "localhost", "::1"):
        require_reach(address, None, UserFile(tmp_path / "users.json"), NOW)


def test_an_expired_certificate_ends_its_names_at_once_and_a_renewed_one_is_taken(make: Make) -> None:
    async def main(clock: VirtualClock) -> None:
        begin_ns, lines = clock.now_ns(), list[str]()
        begins = parse_utc(clock.utc())
        admitted: list[tuple[float, Sequence[str], str]] = []
        alarms: list[tuple[float, AlarmRequest]] = []

        def passed_s() -> float:
            return (clock.now_ns() - begin_ns) / NS_PER_S

        # It ends 90 s from now: certificates have whole seconds.
        certificate = make("tutti.lab", "localhost", begins=begins, days=90 / 86_400)
        ends_s = (certificate.expires - begins).total_seconds()
        log = ProcessLog("gateway", "test", clock, lines.append)
        watch = CertificateWatch(
            certificate,
            clock,
            run_inline,
            log,
            certificate.make_context(),
            lambda names, why: admitted.append((passed_s(), names, why)),
            lambda alarm: alarms.append((passed_s(), alarm)),
            beyond=True,
        )
        clock.loop.create_task(watch.run())
        await sleep_ns(clock, begin_ns + 120 * NS_PER_S - clock.now_ns())
        assert [(at_s, tuple(names)) for at_s, names, _ in admitted] == [
            (0.0, ("tutti.lab",)),
            (60.0, ("tutti.lab",)),
            (pytest.approx(ends_s, abs=1e-6), ()),
        ]
        assert "has expired on" in admitted[-1][2]
        assert [each.priority for _, each in alarms] == ["high", "high", "high"]
        assert "page expired" in alarms[-1][1].text and "page ends in 0 h" in alarms[0][1].text
        # Files that are half copied change nothing; then the new ones count.
        whole = certificate.file.read_bytes()
        certificate.file.write_bytes(whole[:100])
        await sleep_ns(clock, begin_ns + 160 * NS_PER_S - clock.now_ns())
        assert admitted[-1][1] == () and "cannot be used" in alarms[-1][1].text
        make("tutti.lab", "localhost", begins=begins, days=300)
        await sleep_ns(clock, begin_ns + 220 * NS_PER_S - clock.now_ns())
        assert (admitted[-1][1], admitted[-1][2]) == (("tutti.lab",), "")
        assert watch.certificate.expires == begins.replace(microsecond=0) + timedelta(days=300)
        assert len(alarms) == 4 and len(lines) == 2

    run_virtual(main)
