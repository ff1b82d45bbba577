"""The checks of `tutti doctor`, on file systems made for them."""

import socket
from pathlib import Path

import pytest

from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.doctor import system
from orchestrator.runtime.doctor.links import check_links

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize(("source", "state"), [("tsc", "ok"), ("hpet", "warning")])
def test_a_slow_clock_source_is_named(tmp_path: Path, source: str, state: str) -> None:
    write(tmp_path / "sys/devices/system/clocksource/clocksource0/current_clocksource", f"{source}\n")
    found = system.check_clock_source(tmp_path)
    assert found.state == state and source in found.text


def test_a_latency_timer_of_16_ms_has_a_remedy(tmp_path: Path) -> None:
    write(tmp_path / "sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "16\n")
    write(tmp_path / "sys/bus/usb-serial/devices/ttyUSB1/latency_timer", "1\n")
    slow, quick = system.check_usb_latency(tmp_path)
    assert slow.state == "warning" and "ttyUSB0" in slow.text and "tutti service udev" in slow.remedy
    assert quick.state == "ok"


def test_a_disk_that_cannot_be_written_has_failed(tmp_path: Path) -> None:
    assert system.check_disk(tmp_path / "not" / "there").state in ("ok", "warning")  # of the folder above
    assert system.check_disk(Path("/proc/self")).state == "failed"


def test_a_port_in_use_is_a_warning() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        (found,) = system.check_ports([("router", server.getsockname()[1])])
    assert found.state == "warning" and "in use" in found.text


def test_links_of_a_fleet_that_are_not_there_are_named(tmp_path: Path) -> None:
    serial = load_fleet(EXAMPLES / "shrc203.fleet.yaml")
    (found,) = check_links(serial, ["local"], tmp_path)
    assert found.state == "failed" and "is not there" in found.text and found.remedy
    device = next(iter(serial.controllers.values())).link.to_plain()["device"]
    write(tmp_path / device.lstrip("/"), "")
    (found,) = check_links(serial, ["local"], tmp_path)
    assert found.state == "ok"
    assert check_links(serial, ["elsewhere"], tmp_path) == []

    drives = load_fleet(EXAMPLES / "cia402.fleet.yaml")
    assert "/dev/ttyACM0" in check_links(drives, ["local"], tmp_path)[0].text
    ((name, drive),) = drives.controllers.items()
    link = drive.link.model_copy(update={"interface": "socketcan", "channel": "can0"})
    drives = drives.model_copy(update={"controllers": {name: drive.model_copy(update={"link": link})}})
    assert check_links(drives, ["local"], tmp_path)[0].state == "failed"
    write(tmp_path / "sys/class/net/can0/operstate", "down\n")
    down = check_links(drives, ["local"], tmp_path)[0]
    assert down.state == "failed" and "ip link set can0 up" in down.remedy


def test_what_is_the_same_everywhere_is_found_here() -> None:
    assert system.check_python().state == "ok"
    assert system.check_versions().state == "ok" and "eclipse-zenoh" in system.check_versions().text
    assert system.check_realtime().state in ("ok", "warning")
