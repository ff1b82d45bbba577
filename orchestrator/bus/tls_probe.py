"""Why a TLS connection to a router does not come about, in words."""

import socket
import ssl

from orchestrator.bus.identity import Identity

_TIMEOUT_S = 1.0
# The alerts by which a router refuses a certificate (RFC 8446, 6.2), as OpenSSL names them.
_ALERTS = {
    "CERTIFICATE_EXPIRED": "has expired by the router's clock",
    "UNKNOWN_CA": "is of another authority than the router's",
    "CERTIFICATE_UNKNOWN": "is not accepted by the router",
    "BAD_CERTIFICATE": "is not accepted by the router",
    "DECRYPT_ERROR": "is not accepted by the router: its authority has the same name, but another key",
}


def probe_tls(endpoint: str, identity: Identity) -> str:
    """Connect once with an identity; return what is wrong, with the remedy, or "" if nothing is found."""
    if not endpoint.startswith("tls/"):
        return ""
    host, _, port = endpoint.removeprefix("tls/").partition("?")[0].partition("#")[0].rpartition(":")
    host = host.strip("[]")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(identity.authority)
    context.load_cert_chain(identity.certificate, identity.key)
    try:
        with (
            socket.create_connection((host, int(port)), _TIMEOUT_S) as plain,
            context.wrap_socket(plain, server_hostname=host) as secure,
        ):
            secure.settimeout(_TIMEOUT_S / 2)
            secure.recv(1)  # the router's verdict on the certificate comes behind the handshake (TLS 1.3)
    except ssl.SSLCertVerificationError as error:
        if error.verify_code == 62:  # X509_V_ERR_HOSTNAME_MISMATCH
            text = f"the router's certificate is not for {host}"
            return f"{text}; add this address to it (`tutti keys add-router … --address`), or use one that it has"
        return f"the certificate of the router at {endpoint} is not accepted: {error.verify_message}"
    except ssl.SSLError as error:
        known_alerts = (words for alert, words in _ALERTS.items() if alert in (error.reason or ""))
        reason = next(known_alerts, f"leads to an error of TLS ({error.reason})")
        return f"the certificate {identity.common_name} {reason}; see `tutti keys ls`"
    except TimeoutError:
        return ""
    except OSError as error:
        return f"{endpoint}: {error.strerror or error}"
    return ""
