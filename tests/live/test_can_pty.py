"""A simulated CiA 402 drive on an slcan pseudo-terminal, driven by third-party clients and by our own link."""

import asyncio
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from children import LIMIT_S, Children, tell, wait_until

from adapters.link.can import open_can
from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.link.can import CanFrame, CanLink, encode_frames
from orchestrator.model.links import CanBusLink
from sim.cia402.dictionary import EDS

pytestmark = pytest.mark.live

OPTIONS = {"travel": [-20_000, 20_000], "boot_ms": 1}
NODE = 5
BUSY_MS = 500


@pytest.fixture
def port(children: Children) -> Path:
    path = children.folder / "ports" / "bus"
    units = [
        json.dumps({"name": f"n{node}", "address": node, "options": OPTIONS, "seed": node}) for node in (NODE, NODE + 1)
    ]
    _, place = children.simulator("cia402", f"pty:{path}", "--unit", units[0], "--unit", units[1])
    assert place["interface"] == "slcan"
    assert place["channel"] == str(path)
    return path


@pytest.fixture
def network(port: Path) -> Iterator[canopen.Network]:
    network = canopen.Network()
    network.connect(interface="slcan", channel=str(port), bitrate=1_000_000, sleep_after_open=0)
    yield network
    network.disconnect()


def drive_on(network: canopen.Network, node: int) -> Any:
    """The client's own node. Any: what its dictionary yields depends on the EDS, and the library types it as a union."""
    drive: Any = BaseNode402(node, str(EDS))
    drive.TIMEOUT_CHECK_TPDO = LIMIT_S
    network.add_node(drive)
    # By default an answer has 0.3 s; the suite keeps both processors busier than that.
    drive.sdo.RESPONSE_TIMEOUT = LIMIT_S
    # Reported by the heartbeat: the boot-up message was sent before any client listened.
    drive.sdo[0x1017].raw = 20
    # A node of this client takes PDOs that have arrived twice for periodic ones, and waits for the next.
    drive.sdo[0x1800][5].raw = drive.sdo[0x1801][5].raw = 50
    drive.nmt.wait_for_heartbeat(LIMIT_S)
    return drive


def test_canopens_own_profile_402_node_homes_and_moves_a_drive(network: canopen.Network) -> None:
    drive = drive_on(network, NODE)
    assert drive.nmt.state == "PRE-OPERATIONAL"
    assert drive.sdo[0x1008].raw == "Simulated CiA 402 drive"  # segmented: longer than four bytes
    drive.setup_402_state_machine()
    drive.nmt.state = "OPERATIONAL"
    wait_until(lambda: drive.state == "SWITCH ON DISABLED", "the statusword by PDO")
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "SWITCH ON DISABLED"):
        drive.state = state
        assert drive.state == state
    drive.sdo[0x6098].raw = 17
    drive.sdo[0x6099][1].raw = 40_000
    drive.sdo[0x6099][2].raw = 5_000
    assert drive.homing(timeout=LIMIT_S)
    # Homed at the edge of the limit switch, and at rest beyond it: on a busy machine the simulator receives the edge
    # late, and it brakes 5 counts later for each millisecond. The exact distance is tested in virtual time.
    wait_until(lambda: drive.sdo[0x606C].raw == 0, "it rests")
    assert 0 <= drive.sdo[0x6064].raw <= 200 + 5 * BUSY_MS
    # Its mode is written by RPDO 2, whose controlword this client leaves at 0: that switches the drive off.
    drive.op_mode = "PROFILED POSITION"
    drive.state = "OPERATION ENABLED"
    drive.sdo[0x6081].raw = 50_000
    drive.sdo[0x607A].raw = 12_345
    drive.controlword = 0x1F
    wait_until(lambda: bool(drive.sdo[0x6041].raw & 0x1000), "the set-point is acknowledged")
    drive.controlword = 0x0F
    wait_until(lambda: drive.sdo[0x6041].raw & 0x1400 == 0x400, "the target is reached")
    assert drive.sdo[0x6064].raw == 12_345
    drive.state = "SWITCH ON DISABLED"
    assert drive.state == "SWITCH ON DISABLED"


def test_a_block_transfer_and_an_abort(network: canopen.Network) -> None:
    drive = drive_on(network, NODE + 1)
    with drive.sdo[0x1008].open("rb", block_transfer=True) as stream:
        assert stream.read() == b"Simulated CiA 402 drive"
    with drive.sdo[0x6081].open("wb", block_transfer=True, size=4) as stream:
        stream.write((4711).to_bytes(4, "little"))
    assert drive.sdo[0x6081].raw == 4711
    with pytest.raises(canopen.SdoAbortedError) as refused:
        drive.sdo[0x6060].raw = 4
    assert refused.value.code == 0x0609_0030


def test_a_reset_fault_and_an_emergency_reach_a_client(children: Children) -> None:
    path = children.folder / "one"
    process, _ = children.simulator("cia402", f"pty:{path}", "--options", json.dumps(OPTIONS))
    network = canopen.Network()
    network.connect(interface="slcan", channel=str(path), bitrate=1_000_000, sleep_after_open=0)
    try:
        drive = drive_on(network, 1)
        drive.sdo[0x6065].raw = 100
        drive.setup_402_state_machine()
        drive.nmt.state = "OPERATIONAL"
        drive.op_mode = "PROFILED VELOCITY"
        drive.state = "OPERATION ENABLED"
        drive.sdo[0x60FF].raw = 5_000
        tell(process, stall=["1", True])
        wait_until(lambda: drive.state == "FAULT", "the following error")
        assert drive.emcy.log[-1].code == 0x8611
    finally:
        network.disconnect()


# Our own link


def test_our_link_communicates_with_the_drives(port: Path) -> None:
    async def main() -> None:
        link = CanLink(await open_can(model(port), LiveClock()), 1_000_000)
        before_ns = link.send_frames(CanFrame(0x600 + NODE, bytes.fromhex("4018100400000000")))
        async with asyncio.timeout(LIMIT_S):
            while (received := await link.read_frame()).frame.id != 0x580 + NODE:
                pass
        assert received.frame == CanFrame(0x580 + NODE, bytes.fromhex("4318100401000000"))
        assert before_ns < received.at_ns <= raw_ns()
        await link.close()
        with pytest.raises(LinkClosed):
            await link.read_frame()
        with pytest.raises(LinkClosed):
            link.send_frames(CanFrame(0x80))

    asyncio.run(main())


def test_bytes_from_a_firing_process_are_sent_on_our_link(port: Path) -> None:
    async def main() -> None:
        link = CanLink(await open_can(model(port), LiveClock()), 1_000_000)
        os.write(link.byte_link.fileno(), encode_frames(CanFrame(0x600 + NODE, bytes.fromhex("4018100400000000"))))
        async with asyncio.timeout(LIMIT_S):
            while (await link.read_frame()).frame.id != 0x580 + NODE:
                pass
        await link.close()

    asyncio.run(main())


@pytest.mark.parametrize(
    ("interface", "channel", "why"), [("slcan", "/dev/no-such-port", "slcan"), ("none", "x", "interface none")]
)
def test_a_missing_interface_is_refused_with_its_reason(interface: str, channel: str, why: str) -> None:
    async def main() -> None:
        link = CanBusLink(kind="can", interface=interface, channel=channel, address=1)
        with pytest.raises(LinkRefused, match=why):
            await open_can(link, LiveClock())

    asyncio.run(main())


def test_a_bus_that_goes_away_closes_our_link(children: Children) -> None:
    path = children.folder / "gone"
    process, _ = children.simulator("cia402", f"pty:{path}")

    async def main() -> None:
        link = CanLink(await open_can(model(path), LiveClock()), 1_000_000)
        process.terminate()
        async with asyncio.timeout(LIMIT_S):
            with pytest.raises(LinkClosed, match="can "):
                while True:
                    await link.read_frame()
        await link.close()

    asyncio.run(main())


def test_the_adapter_of_the_bus_uses_the_lawicel_protocol(port: Path) -> None:
    with can.Bus(interface="slcan", channel=str(port), bitrate=1_000_000, sleep_after_open=0) as bus:
        assert bus.get_version(LIMIT_S) == (10, 10)  # type: ignore[attr-defined]
        bus.send(can.Message(arbitration_id=0x700 + NODE, is_remote_frame=True, is_extended_id=False, dlc=1))
        give_up_s = time.monotonic() + LIMIT_S
        while (message := bus.recv(0.1)) is None or message.arbitration_id != 0x700 + NODE:
            assert time.monotonic() < give_up_s
        assert message.data == b"\x7f"


def model(port: Path) -> CanBusLink:
    return CanBusLink(kind="can", interface="slcan", channel=str(port), address=NODE)
