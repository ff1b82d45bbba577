"""Why the certificate of a server is not accepted: libpq says only that it is not."""

import re
import socket
import ssl
from pathlib import Path

from psycopg.conninfo import conninfo_to_dict

PROBE_S = 1.0
_SSL_REQUEST = bytes((0, 0, 0, 8, 4, 210, 22, 47))  # PostgreSQL 18, 54.7: its length, and the code 80877103
_PLACE = re.compile(r'server at "([^"]+)"(?: \([^)]*\))?, port (\d+) failed: SSL error: certificate verify failed')


def find_certificate_reason(conninfo: str, text: str) -> str:
    """What OpenSSL says of the certificate that libpq refuses in `text`; empty if another connection does not show it.
    Takes `PROBE_S` for each of its three steps at most."""
    match = _PLACE.search(text)
    if match is None:
        return ""
    root = str(conninfo_to_dict(conninfo).get("sslrootcert") or Path.home() / ".postgresql/root.crt")
    try:
        context = ssl.create_default_context(cafile=None if root == "system" else root)
        context.check_hostname = False  # of another name libpq says more itself
        with socket.create_connection((match[1], int(match[2])), PROBE_S) as plain:
            plain.sendall(_SSL_REQUEST)
            if plain.recv(1) == b"S":
                context.wrap_socket(plain).close()
    except ssl.SSLCertVerificationError as error:
        return error.verify_message
    except OSError:
        pass
    return ""
