"""The simulated SMC-4000, command by command: behaviour that its vectors do not cover. Lines are of the manual."""

from dataclasses import dataclass

import pytest
from unit.sim.desk import Desk

MOVING = ("SHX", "PRX=1000000", "SPX=1000", "BGX")


@dataclass(frozen=True)
class Case:
    """After `before`, `send` is answered by `reply`; `?7` stands for a refusal with TC code 7."""

    lines: str
    send: str
    reply: str
    before: tuple[str, ...] = ()


def case(lines: str, send: str, reply: str, *before: str) -> Case:
    return Case(lines, send, reply, before)


CASES = [
    # Possible queries and their forms
    case("L2222", "AB ?", " 1"),
    case("L2543", "AL ?,?", " 1, 0", "ALX"),
    case("L7599", "MO ?,?", " 0, 1", "SHX"),
    case("L3620", "CM?", " 0"),
    case("L3690", "CN ?", "?51"),
    case("L4729", "EM ?", "?51"),
    case("L9535", "RL ?", "?51"),
    case("L9907", "SC ?", "?51"),
    case("L10471", "TD ?", "?51"),
    case("L10514", "TE ?", "?51"),
    case("L10842", "TP X?", "?4"),
    case("L8317", "PF ?", " 10.0"),
    case("L11383", "VF ?", " 10.4"),
    case("L11215", "VA ?", " 0000256000"),
    case("L6021", "II ?", " 000"),
    case("L6019", "II 1", "?2"),
    # Axis N has what its pages list, and nothing else
    case("L10846", "TPN", " 0000000000"),
    case("L11040", "TVN", "?4"),
    case("L4999", "MG _ERN", "?58"),
    case("L9911", "MG _SCN{F2.0}", " 01"),
    # Fields
    case("L10334", "EP", "?50"),
    case("L10334", "CN", "?50"),
    case("L3642", "CN 1,1,1,1,1", "?4"),
    case("L16428", "TPX", " 000000", "PF 6,6,6,6"),
    case("L10807", "MG _LM{F3.0}", " 511", "VM A,B,C"),
    case("L6899", "MG _LE{F4.0}", " 0500", "LMAB", "LIA=500"),
    case("L11451", "MG _LM{F3.0}", " 510", "VP 1000,1000"),
    case("L7811", "MG ~b{F2.0}", " 10", '~b="N"'),
    case("L7789", "~e=1", "?4"),
    # Names
    case("L16820", "LEN=", " 0000000003.4000", "LEN=3.4"),
    case("L4194", "DM pets[5]", "?57"),
    case("L15912", "MG _DM{F5.0}", " 15000", "DM POSX[7]", "DM POSX[0]"),
    # Expressions
    case("L15620", "V1=((((1+1))))", ""),
    case("L15620", "V1=(((((1+1)))))", "?59"),
    case("L15656", "MG @SIN[0.003]{F1.4}", " 0.0000"),
    case("L15685", "MG @RND[-2.5]{F2.0}", "-02"),
    # Parameters
    case("L6358", "MG @INT[_ITX*10]{F2.0}", " 08", "IT 0.8"),
    case("L8378", "MG _PLX{F1.4}", " 0.9527", "PL .95,.9"),
    case("L8378", "MG _PLY{F1.4}", " 0.8997", "PL .95,.9"),
    case("L10734", "TM -1000", ""),
    case("L12120", "MG _PRX{F4.0}", " 0400", "PA 400"),
    case("L7108", "MG _LS{F2.0}", "-02", "DL\r#A\rEN\r\x1a"),
    # In motion
    case("L3534", "CEX=1", "", *MOVING),
    case("L3291", "BP", "?7", *MOVING),
    case("L3317", "BV", "?7", *MOVING),
    case("L3269", "BN", "", *MOVING),
    case("L9708", "RUX", "?7", *MOVING),
    case("L4549", "ED", "?7", *MOVING),
    # Handles
    case("L10421", 'MG {EC}"x"', "?126"),
    # Absolute encoders are an option
    case("L2442", "AEX=4096", "?1"),
    # Locks and passwords
    case("L6798", "TC1", "130 Command not valid while controller is locked", "PW apple,apple", "LC apple,2", "BN"),
    case("L6756", "MG 1", "?130", "PW apple,apple", "LC apple,2"),
    case("L8450", "MG _KPX{F1.0}", " 1", "KP 7", "BN", "PW apple,apple", "RS"),
    # What BN keeps (L3256-L3273)
    case("L3258", "MG _EP{F2.0}", " 20", "EP 20,100", "BN", "RS"),
    case("L3259", "MG _FAX{F2.0}", " 05", "FA 5", "BN", "RS"),
    case("L3256", "MG _TWX{F5.0}", " 32766", "TW 100", "BN", "RS"),
    # Programs
    case("L14436", "MG _ED{F1.0}", " 0", "DL\r#A\r\rEN\r\x1a"),
    case("L1624", "MG V1{F2.0}", " 05", "V1=5;V2=6"),
]


@pytest.mark.parametrize("each", CASES, ids=lambda each: f"{each.lines}-{each.send}")
def test_a_command_is_answered_as_the_manual_says(each: Case) -> None:
    desk = Desk()
    desk.ask(*each.before)
    answer = desk.ask(each.send)
    if each.reply.startswith("?"):
        assert answer == "?"
        assert int(desk.ask("TC").split()[0]) == int(each.reply[1:])
    else:
        assert answer == (f"{each.reply}\r\n:" if each.reply else ":")


def test_the_address_is_locked_too() -> None:
    """L6789."""
    desk = Desk("serial", echo=False)
    assert desk.ask("PW apple,apple", "LC apple,1", "IA 1,2,3,4") == "?"
    assert desk.ask("LC apple,0", "IA 1,2,3,4") == ":"


def test_an_absolute_encoder_gives_the_axis_its_place() -> None:
    """L2437-L2482, L9145, L11089."""
    desk = Desk(absolute_encoders={"X": 20480, "Y": -4096})
    assert desk.ask("AEX=4096") == ":"
    assert desk.ask("TPX;TYX;QY") == " 0000020480\r\n: 0000020480\r\n:P+00005\r\n:"
    assert desk.ask("AEY=4096", "MG _AE{F1.0}") == " 1\r\n:"
    assert desk.ask("SHX", "AEX=4096") == "?"
    assert desk.ask("AEZ=4096") == "?"


def test_feed_forward_shows_in_the_torque() -> None:
    """L5163 (0.75 V), L5383, L5415 (0.366 V)."""
    desk = Desk()
    desk.ask("SHX", "FA 10", "AC 500000", "JG 30000", "BGX")
    assert float(desk.ask("TTX").split()[0]) == pytest.approx(0.75, abs=0.001)
    desk.wait(1.0)
    assert float(desk.ask("FV 10", "TTX").split()[0]) == pytest.approx(0.366, abs=0.001)


def test_a_steppers_pulses_come_after_its_profile() -> None:
    """L6662, L14096-L14105, L14131: 3 KS samples."""
    desk = Desk()
    desk.ask("MT 2", "KS 8", "SHX", "PRX=1000", "BGX")
    while desk.ask("MG _BGX{F1.0}") != " 0\r\n:":
        desk.wait(1 / 1024)
    assert desk.ask("TDX") != desk.ask("RPX")
    desk.wait(25 / 1024)
    assert desk.ask("TDX") == desk.ask("RPX") == " 0000001000\r\n:"


def test_a_limit_ends_the_gearing_of_an_axis_that_only_follows() -> None:
    """L5543, L13522; in gantry mode it continues (L5493)."""
    desk = Desk()
    desk.ask("SH", "GA ,X,X", "GR ,1,1", "GM ,,1", "JGX=10000", "BGX")
    desk.wait(1.0)
    for axis in "YZ":
        desk.unit.set_limit(axis, "forward")
    stood = desk.ask("RPY")
    assert desk.ask("MG _GRY{F1.0},_GRZ{F1.0},_SCY{F2.0}") == " 0 1 02\r\n:"
    desk.wait(0.5)
    assert desk.ask("RPY") == stood
    assert desk.ask("MG (_RPZ>14000){F1.0}") == " 1\r\n:"


def test_a_latch_target_that_is_stopped_before_is_reported() -> None:
    """L7151-L7159."""
    desk = Desk()
    desk.ask("SHX", "LTX=100000", "ALX", "JGX=5000", "BGX")
    desk.wait(0.5)
    desk.unit.set_input(1, level=False)
    desk.wait(0.1)
    desk.ask("STX")
    desk.rest()
    assert desk.ask("SCX") == " 041\r\n:"


def test_torque_is_recorded_as_a_digital_value() -> None:
    """L16029."""
    desk = Desk()
    desk.ask("SHX", "OF 9.9988", "DM T[5]", "RA T[]", "RD _TTX", "RC 1")
    desk.wait(0.1)
    assert desk.ask("MG T[0]{F5.0}") == " 32703\r\n:"


def test_a_semicolon_ends_a_command_without_carriage_return() -> None:
    """L1624, L12230: also before a download."""
    desk = Desk()
    desk.line.receive_bytes(b"V1=5;V2=6;V")
    assert desk.heard == b"::"
    desk.line.receive_bytes(b"3=7\r")
    assert desk.ask("MG V1+V2+V3{F2.0}") == " 18\r\n:"
    desk.heard = b""
    desk.line.receive_bytes(b'MG "a;b";NO c;V1=9\r')
    assert desk.heard == b"a;b\r\n::"
    desk.heard = b""
    desk.line.receive_bytes(b"DL;#A;PR 4000;BG\rEN\r\x1a")
    assert desk.heard == b":"
    assert desk.ask("LS") == "000 #A;PR 4000;BG\r\n001 EN\r\n:"
    desk.heard = b""
    desk.line.receive_bytes(b"V1=1;" * 20 + b"\r")
    assert desk.heard == b":" * 21


def test_the_editor_changes_a_program_line_by_line() -> None:
    """L4517-L4560."""
    desk = Desk()
    desk.ask("DL\r#A\rPR 5\rBAD\rEN\r\x1a")
    assert desk.ask("ED 1") == "001 PR 5\r\n"
    assert desk.ask("PR 7") == "002 BAD\r\n"
    desk.heard = b""
    for key in (b"\x04", b"\tBG\r", b"\x10"):
        desk.line.receive_bytes(key)
    assert desk.heard == b"002 EN\r\n002 \r\n003 EN\r\n002 BG\r\n"
    assert desk.ask("#A") == "?002 BG\r\n"
    desk.heard = b""
    desk.line.receive_bytes(b"\x11")
    assert desk.heard == b":"
    assert desk.ask("LS") == "000 #A\r\n001 PR 7\r\n002 BG\r\n003 EN\r\n:"
    assert desk.ask("LL") == "# A = 0\r\n:"


def test_a_datagram_carries_no_more_than_a_packet() -> None:
    """L1735."""
    desk = Desk("udp")
    desk.ask("DL\r" + "NO 23456789012345678901234567890\r" * 14 + "\x1a")
    sent: list[int] = []
    line = desk.unit.connect("udp", lambda data: sent.append(len(data)), lambda: None)
    line.receive_bytes(b"UL\r")
    assert len(sent) > 1
    assert max(sent) <= 470


def test_closing_a_handle_itself_is_no_loss() -> None:
    """L5778, L15514: #TCPERR is for connections that the other side has lost."""
    desk = Desk()
    other = desk.unit.connect("tcp", lambda data: None, lambda: None)
    desk.ask("DL\r#A\rWT 100\rJP #A\r#TCPERR\rN=N+1\rRE\r\x1a", "N=0", "XQ #A", "IHB=>-2")
    assert desk.ask("MG N{F1.0}") == " 0\r\n:"
    other.close()
    third = desk.unit.connect("tcp", lambda data: None, lambda: None)
    third.close()
    desk.wait(0.01)
    assert desk.ask("MG N{F1.0},_IA4{F1.0}") == " 1 1\r\n:"


def test_the_abort_input_and_the_selective_ones() -> None:
    """L8030, L9886, L11941; L3670-L3682."""
    desk = Desk()
    desk.ask("SH", "OE ,1", "JG*=5000", "BG", "CN ,,,1")
    desk.wait(0.1)
    desk.unit.set_input(7, level=False)
    assert desk.ask("MG _SCZ{F2.0},_BGZ{F1.0},_BGX{F1.0}") == " 11 0 1\r\n:"
    desk.unit.set_abort(active=True)
    assert desk.ask("MG _SCX{F2.0},_BGX{F1.0},_AB{F1.0},_MOX{F1.0},_MOY{F1.0}") == " 06 0 0 0 1\r\n:"
    assert desk.ask("BGX") == "?"
    desk.unit.set_abort(active=False)
    assert desk.ask("BGX") == ":"
