"""A simulated CiA 402 drive on an slcan pseudo-terminal, driven by canopen's `BaseNode402` and by the tools of
python-can."""

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from children import LIMIT_S, Children, wait_until

from sim.cia402.dictionary import EDS

NODE = 5
TARGET_UNITS = 1_000_000


@pytest.fixture
def port(children: Children) -> Path:
    path = children.folder / "ports" / "bus"
    unit = {"name": "x", "address": NODE, "options": {"boot_ms": 1}, "seed": 1}
    children.simulator("cia402", f"pty:{path}", "--unit", json.dumps(unit))
    return path


@pytest.fixture
def drive(port: Path) -> Iterator[Any]:
    network = canopen.Network()
    network.connect(interface="slcan", channel=str(port), bitrate=1_000_000, sleep_after_open=0)
    node: Any = BaseNode402(NODE, str(EDS))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = LIMIT_S
    node.TIMEOUT_SWITCH_STATE_FINAL = LIMIT_S
    yield node
    network.disconnect()


@pytest.mark.parametrize("code", range(1, 9))
@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "moving"])
def test_a_quick_stop_is_seen_whatever_its_option(drive: Any, code: int, moving: bool) -> None:
    """The client waits for QUICK STOP ACTIVE, by SDO; by CiA 402 the drive leaves that state by itself with the options
    1 to 4."""
    drive.sdo[0x605A].raw = code
    drive.op_mode = "PROFILED POSITION"
    drive.state = "OPERATION ENABLED"
    if moving:
        drive.sdo[0x607A].raw = TARGET_UNITS
        drive.controlword = 0x3F
        wait_until(lambda: drive.sdo[0x606C].raw > 0, "the start of the move")
    drive.state = "QUICK STOP ACTIVE"
    ends = "SWITCH ON DISABLED" if code <= 4 else "QUICK STOP ACTIVE"
    wait_until(lambda: drive.state == ends and drive.sdo[0x606C].raw == 0, f"the state {ends}")
    drive.state = "OPERATION ENABLED"


def test_the_player_and_the_logger_of_python_can(port: Path, children: Children) -> None:
    """The player's query is answered; the logger records the answer."""
    bus = ("-i", "slcan", "-c", str(port), "-b", "1000000")
    frames, recorded = children.folder / "frames.log", children.folder / "recorded.log"
    query = f"{0x600 + NODE:03X}#4000100000000000"
    frames.write_text("".join(f"({at}.000000) can0 {query}\n" for at in range(4)))
    logger = children.start("can.logger", *bus, "-f", str(recorded))
    player = children.start("can.player", *bus, str(frames))
    assert player.wait(LIMIT_S) == 0, player.communicate()
    logger.send_signal(signal.SIGINT)
    assert logger.wait(LIMIT_S) == 0, logger.communicate()
    assert re.search(rf"{0x580 + NODE:03X}#4300100092010200", recorded.read_text())
