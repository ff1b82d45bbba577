"""A browser's part of a test on another computer: `python page_client.py AUTHORITY ADDRESS PORT NAME PASSWORD SECONDS`.

Signs in by TLS, and prints what comes back as one JSON object; also of a wrong `Host`, of TLS 1.1, and of plain HTTP.
"""

import http.client
import json
import socket
import ssl
import sys
import time
from typing import Any


class PageClient:
    """One page at an address. context: verifies the server's certificate."""

    def __init__(self, address: str, port: int, context: ssl.SSLContext, limit_s: float) -> None:
        self._place, self._context, self._limit_s = (address, port), context, limit_s
        self.session: dict[str, str] = {}

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, Any, dict[str, str]]:
        """Send a request; status, body and headers of the answer."""
        link = http.client.HTTPSConnection(*self._place, timeout=self._limit_s, context=self._context)
        try:
            given = {"content-type": "application/json", **self.session, **headers}
            link.request(method, path, json.dumps(body or {}), given)
            answer = link.getresponse()
            return answer.status, json.loads(answer.read()), {k.lower(): v for k, v in answer.getheaders()}
        finally:
            link.close()

    def sign_in(self, user: str, password: str) -> dict[str, str]:
        """Begin a session; the headers of the answer."""
        _, session, headers = self.ask("POST", "/v1/login", {"user": user, "password": password})
        self.session = {"cookie": headers["set-cookie"].partition(";")[0], "x-tutti-csrf": session["csrf"]}
        return headers


def speak_plainly(address: str, port: int, limit_s: float) -> str:
    """What a plain HTTP request gets back."""
    with socket.create_connection((address, port), limit_s) as link:
        link.sendall(f"GET /v1/state HTTP/1.1\r\nHost: {address}:{port}\r\n\r\n".encode())
        try:
            return link.recv(100).decode("latin-1")
        except ConnectionResetError:
            return ""


def try_tls_1_1(address: str, port: int, limit_s: float) -> str:
    """The version of TLS that comes about where no newer one than 1.1 is offered; empty: none."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.set_ciphers("DEFAULT:@SECLEVEL=0")
    context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
    with socket.create_connection((address, port), limit_s) as link:
        try:
            with context.wrap_socket(link) as secure:
                return secure.version() or ""
        except (ssl.SSLError, ConnectionResetError):
            return ""


def main() -> None:
    authority, address, port, user, password, limit_s = sys.argv[1:]
    place = (address, int(port), float(limit_s))
    context = ssl.create_default_context(cafile=authority)
    client = PageClient(*place[:2], context, place[2])
    headers = client.sign_in(user, password)
    until_s = time.monotonic() + place[2]
    while not (state := client.ask("GET", "/v1/state")[1])["alarms"] and time.monotonic() < until_s:
        time.sleep(0.2)
    found = {
        "cookie": headers["set-cookie"],
        "strict": headers.get("strict-transport-security", ""),
        "controllers": sorted(state["controllers"]),
        "alarms": sorted({each["kind"] for each in state["alarms"].values()}),
        "stop": client.ask("POST", "/v1/stop")[0],
        "host": client.ask("POST", "/v1/stop", Host="evil.example")[0],
        "origin": client.ask("POST", "/v1/stop", Origin="https://evil.example")[0],
        "plain": speak_plainly(*place),
        "tls_1_1": try_tls_1_1(*place),
    }
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
