"""The page for another computer, by TLS with the fleet's certificate, and a bus without TLS that each view names.

In a network namespace with an address of its own: nothing of it leaves this computer.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from children import LIMIT_S
from fleet import COMMAND, EXAMPLES
from parts import Part
from test_namespaces import run

from orchestrator.gateway.access.users import UserFile
from orchestrator.keys.folder import KeyFolder
from orchestrator.runtime.state.folder import USERS_FILE

pytestmark = [
    pytest.mark.live,
    pytest.mark.alone,
    pytest.mark.skipif(os.geteuid() != 0 or shutil.which("ip") is None, reason="network namespaces need root and `ip`"),
]

ADDRESS, BUS, PORT = "10.77.0.1", "tcp/127.0.0.1:7447", "8443"
FILE, PASSWORD = EXAMPLES / "demo.fleet.yaml", "correct horse"
HERE = Path(__file__).parent


@pytest.fixture
def computer() -> Iterator[str]:
    """A namespace with one address beside loopback."""
    name = f"tutti-page-{os.getpid()}"
    run("ip", "netns", "add", name)
    try:
        run("ip", "-n", name, "link", "set", "lo", "up")
        run("ip", "-n", name, "address", "add", f"{ADDRESS}/32", "dev", "lo")
        yield name
    finally:
        run("ip", "netns", "delete", name)


def look(computer: str, *command: str) -> str:
    done = subprocess.run(
        ["ip", "netns", "exec", computer, *command], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_another_computer_uses_the_page_by_tls_and_every_view_names_an_open_bus(computer: str, tmp_path: Path) -> None:
    keys, state = tmp_path / "keys", tmp_path / "state"
    folder = KeyFolder(keys)
    folder.init("demo", datetime.now(UTC), 100)
    folder.add("gateway", "page", datetime.now(UTC), 100, (ADDRESS, "localhost"))
    state.mkdir(mode=0o700)
    UserFile(state / USERS_FILE).add_user("olga", "operator", PASSWORD, "2026-01-01T00:00:00.000000Z")
    router = [*COMMAND, "router", str(FILE), "--listen", "tcp/0.0.0.0:7447", "--insecure", "--state", str(state)]
    up = [*COMMAND, "up", str(FILE), "--sim", "--state", str(state), "--connect", BUS, "--no-record"]
    up += ["--web-host", ADDRESS, "--web-port", PORT, "--keys", str(keys)]
    said = tmp_path / "said"
    said.mkdir()
    parts: list[Part] = []
    try:
        parts.append(Part(said, computer, None, *router))
        parts[0].wait_for("router on")
        parts.append(Part(said, computer, None, *up))
        parts[1].wait_for("is up")
        assert f"page on https://{ADDRESS}:{PORT}/" in parts[1].said.read_text()
        client = [sys.executable, str(HERE / "page_client.py"), str(keys / "ca.pem"), ADDRESS, PORT]
        found = json.loads(look(computer, *client, "olga", PASSWORD, str(LIMIT_S)))
        cookie = found.pop("cookie").lower()
        assert "secure" in cookie and "httponly" in cookie
        assert found == {
            "strict": "max-age=2592000",
            "controllers": ["gantry", "stage"],
            "alarms": ["open-bus"],
            "stop": 200,
            "host": 403,
            "origin": 403,
            "plain": "",
            "tls_1_1": "",
        }
        bus = ["--connect", BUS]
        words = "INSECURE: the bus at tcp/0.0.0.0:7447 has no TLS"
        parts.append(Part(said, computer, None, *COMMAND, "watch", *bus))
        assert words in " ".join(look(computer, *COMMAND, "status", *bus).split())
        parts[2].wait_for(words)
    finally:
        for part in reversed(parts):
            part.end()
