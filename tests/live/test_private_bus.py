"""`tutti up --private`: a socket that no other user of the computer reaches."""

import os
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from children import wait_until
from fleet import EXAMPLES, RunningFleet

pytestmark = pytest.mark.live

# As another user, once the interpreter runs: that one may not reach its files.
CONNECT = """import os, socket, sys
os.setgroups([]); os.setgid(65534); os.setuid(65534)
socket.socket(socket.AF_UNIX).connect(sys.argv[1])"""


@pytest.fixture(scope="module")
def bus() -> Iterator[Path]:
    """The socket of a fleet without adapter hosts, in a folder that every user may pass."""
    with TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        fleet = RunningFleet(Path(name), EXAMPLES / "demo.fleet.yaml", "--private", "--no-hosts")
        try:
            # Not until it is up: that would be 3 s later, when it has given up waiting for controllers without a host.
            wait_until(lambda: "router on" in fleet.output() or fleet.up.poll() is not None, "its router listens")
            yield fleet.state / "bus.sock"
        finally:
            fleet.close()


def test_the_socket_is_for_its_own_user(bus: Path) -> None:
    assert stat.S_ISSOCK(bus.stat().st_mode) and stat.S_IMODE(bus.stat().st_mode) == 0o600
    assert stat.S_IMODE(bus.parent.stat().st_mode) == 0o700
    with socket.socket(socket.AF_UNIX) as own:
        own.connect(str(bus))


@pytest.mark.skipif(os.geteuid() != 0, reason="to be another user needs root")
def test_another_user_is_kept_out_by_the_folder_and_by_the_socket(bus: Path) -> None:
    for mode in (0o700, 0o755):
        bus.parent.chmod(mode)
        command = [sys.executable, "-S", "-c", CONNECT, str(bus)]
        tried = subprocess.run(command, capture_output=True, text=True)
        assert "PermissionError" in tried.stderr, tried
    bus.parent.chmod(0o700)
