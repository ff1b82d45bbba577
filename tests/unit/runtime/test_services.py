"""Units of systemd, messages to the service manager, and fields in the journal."""

import asyncio
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from orchestrator.bus.journald import JournalSender, encode_fields
from orchestrator.clock.service_manager import READY, WATCHDOG, ServiceManager
from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.services.parts import PARTS
from orchestrator.runtime.services.units import ServicePlace, find_stop_s, make_unit, make_unit_name

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
NO_SYSTEMD = shutil.which("systemd-analyze") is None


def place() -> ServicePlace:
    return ServicePlace(
        fleet=load_fleet(EXAMPLES / "demo.fleet.yaml"),
        file=EXAMPLES / "demo.fleet.yaml",
        command=Path(sys.executable),  # systemd-analyze wants a program that exists
        python=Path(sys.executable),
        user="root",
        connect="tls/192.168.1.5:7447",
        host="local",
        identity=Path("/etc/tutti/local"),
    )


@pytest.mark.parametrize("part", PARTS)
def test_a_unit_says_when_it_is_ready_and_how_long_it_may_take_to_end(part: str) -> None:
    lines = make_unit(part, place()).splitlines()
    for wanted in ("Type=notify", "NotifyAccess=all", "KillMode=mixed", "LimitRTPRIO=4", "RestrictRealtime=no"):
        assert wanted in lines
    assert "Environment=TUTTI_IDENTITY=/etc/tutti/local" in lines
    assert f"TimeoutStopSec={find_stop_s(place().fleet)}" in lines
    ramps_s = [
        a.limits.velocity / a.limits.acceleration for c in place().fleet.controllers.values() for a in c.axes.values()
    ]
    assert find_stop_s(place().fleet) > max(ramps_s)


def test_the_page_of_other_computers_is_served_with_the_certificate_of_the_gateway() -> None:
    beyond = replace(place(), web_host="0.0.0.0", web_port=8443)
    (command,) = [line for line in make_unit("gateway", beyond).splitlines() if line.startswith("ExecStart=")]
    assert "--port 8443 --address 0.0.0.0" in command
    assert "--ssl-certfile /etc/tutti/local/cert.pem --ssl-keyfile /etc/tutti/local/key.pem" in command
    assert "--address" not in make_unit("gateway", place())


def test_only_the_part_with_serial_ports_may_use_them() -> None:
    assert "DeviceAllow=char-ttyUSB rw" in make_unit("host", place()) and "dialout" in make_unit("host", place())
    for part in ("router", "coordinator", "gateway", "recorder"):
        assert "PrivateDevices=yes" in make_unit(part, place()) and "ttyUSB" not in make_unit(part, place())


@pytest.mark.skipif(NO_SYSTEMD, reason="systemd-analyze is not installed")
def test_systemd_takes_all_units_and_finds_them_confined(tmp_path: Path) -> None:
    paths: list[Path] = []
    for part in PARTS:
        path = tmp_path / make_unit_name(part, place())
        path.write_text(make_unit(part, place()))
        paths.append(path)
    verified = subprocess.run(["systemd-analyze", "verify", "--man=no", *paths], capture_output=True, text=True)
    assert verified.returncode == 0 and "tutti" not in verified.stderr, verified.stderr
    checked = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=45", *paths], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stdout[-2000:]


@pytest.fixture
def manager_socket(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.settimeout(10)
        yield receiver


def test_the_watchdog_is_fed_only_by_progress(tmp_path: Path, manager_socket: socket.socket) -> None:
    manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "3000"})
    assert manager.watchdog_s == 0.003
    manager.notify(READY)
    asked, work = 0, 0

    async def feed() -> None:
        nonlocal asked, work

        def count() -> int:
            nonlocal asked, work
            asked += 1
            work = min(asked, 3)  # it works three times, and then no more
            return work

        feeding = asyncio.create_task(manager.feed_watchdog(count))
        while asked < 10:
            await asyncio.sleep(0)
        feeding.cancel()

    asyncio.run(feed())
    manager_socket.setblocking(False)
    said: list[str] = []
    with pytest.raises(BlockingIOError):
        while True:
            said.append(manager_socket.recv(100).decode())
    assert said == [READY, WATCHDOG, WATCHDOG, WATCHDOG]


def test_without_a_service_manager_nothing_is_sent() -> None:
    manager = ServiceManager({})
    manager.notify(READY)
    assert manager.watchdog_s is None
    asyncio.run(asyncio.wait_for(manager.feed_watchdog(lambda: 1), 10))


def test_fields_of_a_log_line_are_fields_of_the_journal(tmp_path: Path) -> None:
    entry = {"utc": "2026-01-01", "level": "warning", "role": "host", "id": "lab2", "text": "late", "fleet_ns": 7}
    fields = encode_fields(entry).decode().splitlines()
    assert {"MESSAGE=late", "PRIORITY=4", "TUTTI_ROLE=host", "TUTTI_ID=lab2", "TUTTI_FLEET_NS=7"} <= set(fields)
    # A text of several lines has its length before it.
    assert encode_fields({"text": "a\nb"}).startswith(b"MESSAGE\n" + (3).to_bytes(8, "little") + b"a\nb\n")
    sender = JournalSender(str(tmp_path / "nothing"))
    sender.send_line('{"text": "lost"}')  # a journal that is not there is no error
    sender.send_line("not JSON")
    sender.close()


HARD_PATHS = ["/x/lab 2", '/x/a"b', "/x/50%h", "/x/$HOME", "/x/it's", "/x/back\\slash", "/x/€;&|"]


def read_words(text: str) -> list[str]:
    """The words of a command line as `systemd.service(5)` says: quotes, escapes of C, then `%%` and `$$`."""
    words: list[str] = []
    for match in re.finditer(r'"((?:[^"\\]|\\.)*)"|(\S+)', text):
        word = re.sub(r"\\(.)", r"\1", match[1]) if match[1] is not None else match[2]
        words.append(word.replace("%%", "%").replace("$$", "$"))
    return words


@pytest.mark.parametrize("folder", HARD_PATHS)
def test_paths_are_quoted_by_the_rules_of_systemd(folder: str) -> None:
    hard = replace(place(), file=Path(folder) / "f.yaml", identity=Path(folder), keys=Path(folder) / "k", web_host="::")
    for part, wanted in (
        ("router", f"{folder}/k"),
        ("coordinator", f"{folder}/f.yaml"),
        ("gateway", f"{folder}/key.pem"),
    ):
        (line,) = [line for line in make_unit(part, hard).splitlines() if line.startswith("ExecStart=")]
        assert wanted in read_words(line.removeprefix("ExecStart=")), line
    (line,) = [line for line in make_unit("router", hard).splitlines() if "TUTTI_IDENTITY" in line]
    setting = line.removeprefix("Environment=").replace("$", "$$")  # which means nothing there
    assert read_words(setting) == [f"TUTTI_IDENTITY={folder}"]


def test_a_path_with_a_line_break_is_refused() -> None:
    with pytest.raises(ValueError, match="has a line break"):
        make_unit("coordinator", replace(place(), file=Path("/x/a\nExecStart=/bin/sh")))


@pytest.mark.skipif(NO_SYSTEMD, reason="systemd-analyze is not installed")
def test_systemd_takes_units_with_hard_paths(tmp_path: Path) -> None:
    paths: list[Path] = []
    for number, folder in enumerate(HARD_PATHS):
        unit = tmp_path / f"tutti-demo-{number}.service"
        unit.write_text(make_unit("coordinator", replace(place(), file=Path(folder) / "f.yaml", identity=Path(folder))))
        paths.append(unit)
    verified = subprocess.run(["systemd-analyze", "verify", "--man=no", *paths], capture_output=True, text=True)
    assert verified.returncode == 0 and "tutti-demo" not in verified.stderr, verified.stderr
