"""A server whose TLS a client cannot take. The test servers have none: this one answers no more than its certificate,
and that it wants one.

The files in `certificates` are made once: `ca` and `other` are authorities, the rest is of `ca` for 127.0.0.1, until
2126. `over` ended in 2026, `future` begins in 2125, and `elsewhere` is for 127.0.0.9.
"""

import socket
import ssl
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip("psycopg")

from orchestrator.coordinator.journal.postgres.opening import open_journal
from orchestrator.coordinator.journal.records import JournalError

pytestmark = pytest.mark.postgres

FILES = Path(__file__).parent / "certificates"
FATAL = b"SFATAL\0VFATAL\0C28000\0Mconnection requires a valid client certificate\0\0"
ASKS_BYTES = 8


def answer_connections(listening: socket.socket, certificate: str) -> None:
    """Answer those that ask for TLS, one after the other, until the socket is closed. certificate: empty: no TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    if certificate:
        context.load_cert_chain(FILES / f"{certificate}.pem")
    while True:
        try:
            plain, _ = listening.accept()
        except OSError:
            return
        with plain, suppress(OSError):
            if not plain.recv(ASKS_BYTES):
                continue  # it asked only whether it is there
            plain.sendall(b"S" if certificate else b"N")
            if certificate:
                with context.wrap_socket(plain, server_side=True) as secure:
                    secure.recv(1000)
                    secure.sendall(b"E" + (len(FATAL) + 4).to_bytes(4, "big") + FATAL)


@pytest.fixture
def port(request: pytest.FixtureRequest) -> Iterator[int]:
    with ThreadPoolExecutor(1) as threads, socket.create_server(("127.0.0.1", 0)) as listening:
        threads.submit(answer_connections, listening, request.param)
        yield listening.getsockname()[1]
        listening.shutdown(socket.SHUT_RDWR)


@pytest.mark.parametrize(
    ("port", "options", "shown"),
    [
        ("good", "verify-full&sslrootcert=ca", "asks for a certificate of ours .*sslcert="),
        ("over", "verify-full&sslrootcert=ca", r"not accepted \(certificate has expired\); renew it .* the clock"),
        ("over", "require&sslrootcert=ca", r"not accepted \(certificate has expired\); renew it .* the clock"),
        ("future", "verify-ca&sslrootcert=ca", r"not accepted \(certificate is not yet valid\); set the clock"),
        ("good", "verify-ca&sslrootcert=other", r"not accepted \(unable to get local issuer .*sslrootcert=FILE"),
        ("good", "verify-ca&sslrootcert=none", "the file of its authority is missing .*sslrootcert=FILE"),
        ("elsewhere", "verify-full&sslrootcert=ca", "not match host name .* use a name of the certificate"),
        ("", "require", "it has no TLS, and the address asks for it .* set ssl = on there"),
    ],
    indirect=["port"],
)
def test_what_is_wrong_with_a_certificate_is_named(port: int, options: str, shown: str) -> None:
    mode, _, root = options.partition("&sslrootcert=")
    address = f"postgresql://tutti:secret@127.0.0.1:{port}/x?sslmode={mode}"
    with pytest.raises(JournalError, match=shown) as caught:
        open_journal(f"{address}&sslrootcert={FILES}/{root}.pem" if root else address, "lab")
    assert caught.value.remedy and "\n" not in str(caught.value) and "secret" not in str(caught.value)
