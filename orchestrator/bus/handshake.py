"""A TLS handshake in memory, by which a certificate is verified and read with the standard library alone."""

import ssl
from datetime import UTC, datetime
from typing import Any

NO_CHECK_TIME = 0x200000  # X509_V_FLAG_NO_CHECK_TIME of OpenSSL: an expired certificate is read, too

Peer = dict[str, Any]
"""A certificate as `ssl.SSLSocket.getpeercert` returns it; empty if the other side was not verified."""


def shake_hands(client: ssl.SSLContext, server: ssl.SSLContext) -> tuple[Peer, Peer]:
    """Let a client and a server of this process connect; return what each has verified of the other: the server's
    certificate, the client's. Raises `ssl.SSLError`."""
    server.maximum_version = ssl.TLSVersion.TLSv1_2  # there a handshake ends only when both sides are verified
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    connecting = client.wrap_bio(to_client, to_server, server_side=False)
    accepting = server.wrap_bio(to_server, to_client, server_side=True)
    ends = [connecting, accepting]
    while ends:
        for end in list(ends):
            try:
                end.do_handshake()
                ends.remove(end)
            except ssl.SSLWantReadError:
                continue
    return connecting.getpeercert() or {}, accepting.getpeercert() or {}


def read_instant(text: str) -> datetime:
    """The instant in `notBefore` or `notAfter` of a certificate."""
    return datetime.fromtimestamp(ssl.cert_time_to_seconds(text), UTC)


def name_reason(error: Exception) -> str:
    """What OpenSSL or the operating system says, in lower-case words."""
    if isinstance(error, ssl.SSLError):
        return (error.reason or "unreadable").lower().replace("_", " ")
    return str(error)
