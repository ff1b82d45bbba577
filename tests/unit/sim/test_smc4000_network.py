"""The simulated SMC-4000 as a master on Ethernet: other controllers, hosts, Modbus devices."""

import struct
from collections.abc import Callable

import pytest
from unit.sim.desk import Desk

from orchestrator.link.supply import PowerSupply
from sim.core.controller import FirmwareTiming, PortConnection, SendBytes
from sim.yaskawa import SMC4000
from sim.yaskawa.io.network import DeviceNetwork

OTHER = "192,168,3,11"
OTHER_NUMBER = int.from_bytes(bytes((192, 168, 3, 11)), "big") - (1 << 32)


class Device:
    """A Modbus device of 32 coils and 16 registers; `packets` are the packets that it received."""

    def __init__(self) -> None:
        self.packets: list[bytes] = []
        self.coils = [False] * 32
        self.registers = [0] * 16
        self.hang_up: Callable[[], None] = lambda: None
        self.supply = PowerSupply()

    def connect(self, port: str, send: SendBytes, closed: Callable[[], None]) -> PortConnection:
        self._send, self.hang_up = send, closed
        return self

    def receive_bytes(self, data: bytes) -> None:
        self.packets.append(data)
        unit, function, body = data[6], data[7], data[8:]
        first, count = struct.unpack(">HH", body[:4]) if len(body) >= 4 else (0, 0)
        if function in (1, 2):
            values = self.coils[first : first + count]
            bits = sum(level << k for k, level in enumerate(values)).to_bytes((count + 7) // 8, "little")
            reply = bytes([len(bits)]) + bits
        elif function in (3, 4):
            reply = bytes([2 * count]) + struct.pack(f">{count}H", *self.registers[first : first + count])
        elif function == 5:
            self.coils[first], reply = count == 0xFF00, body
        elif function == 6:
            self.registers[first], reply = count, body
        elif function == 16:
            self.registers[first : first + count] = struct.unpack(f">{count}H", body[5:])
            reply = body[:4]
        else:
            function, reply = function | 0x80, b"\x01"
        self._send(struct.pack(">HHHBB", 0, 0, len(reply) + 2, unit, function) + reply)

    def close(self) -> None:
        self.packets.append(b"closed")


def pair(desk: Desk, latency_ns: int = 0) -> Desk:
    """Another controller on the same clock and network, with a host of its own."""
    other = Desk.__new__(Desk)
    other.clock, other.heard, other.hung_up = desk.clock, b"", False
    other.unit = SMC4000.build_controller(
        desk.clock, {"address": OTHER_NUMBER}, timing=FirmwareTiming(decode_ns=500_000)
    )
    other.open("tcp")
    network = DeviceNetwork(latency_ns)
    for unit in (desk.unit, other.unit):
        unit.join_network(network)
    return other


@pytest.mark.parametrize("latency_ns", [0, 200_000])
def test_one_controller_commands_another_and_reads_what_it_answers(latency_ns: int) -> None:
    """L1789-L1806, L9743-L9783."""
    desk = Desk()
    other = pair(desk, latency_ns)
    other.ask("SH", "DP 132", wait_s=0.01)
    desk.ask(f"IHB={OTHER}<23>2", wait_s=0.05)
    assert desk.ask("MG _IHB2{F2.0},_IHB3{F1.0},_IHB1{F5.0}") == "-02 0 00023\r\n:"
    desk.ask('SAB="TPX"', wait_s=0.05)
    assert desk.ask("MG _IHB4{F1.0},_SAB{F4.0},_SAB1{F10.0}") == " 2 0132-2147483648\r\n:"
    desk.ask("V=7", 'SAB="KI",V,2.5', wait_s=0.05)
    assert other.ask("KI ?,?", wait_s=0.01) == " 0007, 0003\r\n:"
    desk.ask('SAB="XX",1', wait_s=0.05)
    assert desk.ask("MG _IHB4{F1.0}") == " 3\r\n:"
    assert desk.ask('SAC="TE"') == "?"
    assert desk.ask("TC") == " 126\r\n:"


def test_messages_go_to_a_handle_and_a_lost_peer_calls_tcperr() -> None:
    """L9744, L15514, L5778."""
    desk = Desk()
    device, network = Device(), DeviceNetwork()
    desk.unit.join_network(network)
    network.places[OTHER_NUMBER] = device
    device.receive_bytes = device.packets.append  # pyright: ignore[reportAttributeAccessIssue]
    desk.ask(f"IHD={OTHER}", "DL\r#A\rWT 100\rJP #A\r#TCPERR\rH=_IA4\rRE\r\x1a", "H=-1", "XQ #A", 'MG {ED}"HELLO"')
    assert device.packets == [b"HELLO\r\n"]
    assert desk.ask("MG _IHD2{F2.0},_IA2{F1.0}") == "-02 6\r\n:"
    device.hang_up()
    desk.wait(0.01)
    assert desk.ask("MG H{F2.0},_IHD2{F2.0},_IA2{F1.0}") == " 03 00 7\r\n:"
    assert desk.ask('MG {ED}"HELLO"') == "?"


def test_an_empty_address_is_reported_and_an_unanswered_command_times_out() -> None:
    """L5892, L5924, L10419."""
    desk = Desk()
    desk.unit.join_network(DeviceNetwork())
    desk.ask("IHB=1,2,3,4")
    assert desk.ask("TC1") == "125 No ARP response from IP address\r\n:"
    assert desk.ask("MG _IHB2{F2.0},_IHB3{F1.0}") == "-06 1\r\n:"
    desk.ask('SAB="TE"')
    assert desk.ask("MG _IHB4{F1.0}") == " 1\r\n:"
    desk.wait(1.1)
    assert desk.ask("MG _IHB4{F1.0}") == " 4\r\n:"


def test_modbus_packets_and_points() -> None:
    """L1824-L1898, L7277-L7380; SB 6002 is output 2 of the device on handle F (L3438)."""
    desk = Desk()
    device, network = Device(), DeviceNetwork()
    desk.unit.join_network(network)
    network.places[OTHER_NUMBER] = device
    assert desk.ask("SB 6002") == "?"
    desk.ask(f"IHF={OTHER}<502>2", "DM A[4]")
    device.registers[:4] = [1, 2, 0xFFFF, 4]
    assert desk.ask("MBF=6,3,0,4,A[]") == ":"
    assert desk.ask("MG A[0]{F5.0},A[2]{F5.0}") == " 00001 65535\r\n:"
    assert device.packets[-1] == bytes((0, 0, 0, 0, 0, 6, 6, 3, 0, 0, 0, 4))
    assert desk.ask("MBF=6,6,9,300") == ":"
    assert device.registers[9] == 300
    assert desk.ask("A[0]=5", "A[1]=6", "MBF=6,16,2,2,A[]") == ":"
    assert device.registers[2:4] == [5, 6]
    assert desk.ask("SB 6002") == ":"
    assert device.coils[:3] == [False, True, False]
    assert desk.ask("MG @OUT[6002]{F1.0},@IN[6001]{F1.0}") == " 1 0\r\n:"
    assert desk.ask("AO 6016,5") == ":"
    assert desk.ask("MG @AN[6016]{F1.2}") == " 5.00\r\n:"
    assert desk.ask("MBF=6,99,0,1") == "?"
    assert desk.ask("TC") == " 127\r\n:"
    assert desk.ask("MBF=6,7,A[]") == ":"
    assert desk.ask("TC") == " 121\r\n:"
    assert desk.ask("IHF=>-2") == ":"
    assert device.packets[-1] == b"closed"
