"""Every op-code of the other makes in every form, also wrong ones, from a client and from stored programs: each is
answered or refused as the make does it, none ends a simulator or keeps it from answering later. The Yaskawas:
`test_yaskawa_forms.py`."""

from collections.abc import Iterable

import pytest
from unit.sim.cia402_bench import CanBench
from unit.sim.test_ppsmc import Client
from unit.sim.test_ppsmc import Rig as PpsmcRig
from unit.sim.test_shrc203 import Rig as ShrcRig
from unit.sim.test_smc30 import Rig as Smc30Rig

from orchestrator.clock.queue import EventQueue
from sim.core.vectors import find_simulator
from sim.ppsmc.dispatch import COMMANDS
from sim.ppsmc.program import NAMES as PROGRAM_NAMES

HUGE = "9999999999999999999"
NUMBERS = ("0", "1", "2", "7", "99", "-1", "+1", "1.5", "1e9", HUGE, f"-{HUGE}", "0x1F", "nan", "inf", "1/0")
ODD = ("", " ", "?", "=", "=1", ":", ",", ",,,", "-", "+", ".", "x", "é", "\x00", '"', "(", "<1>", "#", "*", "%s", "{}")
MANY = ("1,2", "1,,2", ",1", "1,2,3,4,5,6,7,8,9", "1" * 300, "1," * 200, "1 2 3")
ARGUMENTS = (*ODD, *NUMBERS, *MANY)


def cased(op: str) -> Iterable[str]:
    """The op-code, and the one in the other case."""
    yield op
    if op.swapcase() != op:
        yield op.swapcase()


# SHRC-203: a line has exactly one answer, until it restarts.

SHRC_FAMILIES = {
    "P": ["ON", "OFF", "R", "P1", "INIT", "SET", "GET", "DEL", "INS", "S", "E", "EX", "L", "CLR"],
    "MS": ["ON", "OFF", "SET", "GET", "DEF", "DEFR", "SETK", "GETK", "DEFK", "DEFRK"],
    "PIT": ["SET", "GET", "DEL", "HRT", "GRT"],
    "PAV": ["SET", "GET", "DEL", "HRT", "GRT"],
}
SHRC_HEADS = [
    "!",
    "Q",
    "SRQ",
    "?",
    "I",
    "PSET",
    "RESET",
    "SLEEP",
    "BO",
    "MODE",
    "FMT",
    "F",
    "C",
    "BEC",
    "BEEP",
    "S",
    "W",
    "D",
    "DS",
    "DF",
    "DR",
    "JD",
    "JO",
    "B",
    "O",
    "T",
    "WT",
    "WI",
    "R",
    "RC",
    "L",
    "M",
    "MP",
    "A",
    "AP",
    "E",
    "EP",
    "K",
    "KP",
    "G",
    "GC",
    "J",
    "Z",
    "ZRT",
    "H",
    "H0",
    "H1",
    "H4",
    "HRT",
    "HRT0",
    "HRT2",
    "XX",
]
SHRC_ARGUMENTS = (
    *("1", "3", "4", "A", "B", "W", "1+P100", "A+P1-P2", "W+U1+N2+M.1", "1+P", "1P100", "+P1+P2+P3", "D+P1+P2+P3"),
    *("1S100F1000R100", "1S0F0R0", "AS1F1R1S1F1R1", f"1S{HUGE}F{HUGE}R{HUGE}", f"1+P{HUGE}", f"1-P{HUGE}", "E", "S"),
    *("1,10", "A,1,2", "1 50", "1,1", "D100,CW,+P1+P1", "Ta", "T1", "P1P2", "E1P2", "M", "S,1,2", "HOST", "HIT", "A,A"),
)
SHRC_PROGRAM_LINES = (
    *(
        "M,1,0,0,100,0,0,0,1,0,5",
        "INPUT,2",
        "END",
        "FOR,0",
        "FOR,3",
        "NEXT",
        "GOTO,1",
        "GOTO,99",
        "WAIT,1",
        "H,1",
        "Z,1",
    ),
    *("M", "M,,,,,,,,,,", f"M,{HUGE}", "R,1", "K,1,2", "E,1", "X", "LOOP", "CALL,1", "TRG,1", "OUT,63", "OUT,64"),
)


def answer_of_shrc(rig: ShrcRig, text: str) -> str:
    """The first line that comes after `text`, or after its repetition: while the unit restarts it takes no input."""
    for _ in range(2):
        before = len(rig.said)
        rig.port.receive_bytes(text.encode("latin-1") + b"\r\n")
        if len(rig.said) > before:
            return rig.said[before][1]
        rig.wait(30)
    raise AssertionError(f"no answer to {text!r}")


def test_shrc203() -> None:
    heads = [*SHRC_HEADS, *SHRC_FAMILIES, *(f"?:{head}" for head in (*SHRC_HEADS, *SHRC_FAMILIES, "AXIS", "V", "N"))]
    for head in heads:
        rig = ShrcRig()
        inner = [
            f"{each}{tail}" for each in SHRC_FAMILIES.get(head, []) for tail in ("", ",1", ",1,1,1", f",{HUGE}", ",x")
        ]
        for name in cased(head):
            answer_of_shrc(rig, name)
            for argument in (*ARGUMENTS, *SHRC_ARGUMENTS, *inner):
                answer_of_shrc(rig, f"{name}:{argument}" if "?:" not in name else f"{name}{argument}")
        for leave in ("P:OFF", "MS:OFF", "MODE:HOST", "P:E", "FMT:SHOT"):
            answer_of_shrc(rig, leave)
        rig.wait(60)
        assert answer_of_shrc(rig, "*IDN?").startswith("SIGMAKOKI"), head


def test_shrc203_programs() -> None:
    for line in SHRC_PROGRAM_LINES:
        rig = ShrcRig()
        for text in (
            "P:R",
            "P:P1",
            "P:ON",
            "P:INIT",
            f"P:SET,1,{line}",
            "P:SET,2,END",
            f"P:SET,3,{line}",
            "P:OFF",
            "P:S",
        ):
            answer_of_shrc(rig, text)
        rig.wait(5)
        assert answer_of_shrc(rig, "*IDN?").startswith("SIGMAKOKI"), line


# pp-electronic SMC: nothing answers a setting; with echo 1 an error is a line.

PPSMC_ARGUMENTS = (
    *("1:0", "1:1", "1:-1", "2:5", "9:1", f"1:{HUGE}", "1:x", "1:", ":", ":1", "1:1:1", "1x", "1:1,2:2", "all", "none"),
    *("1:1s5", "1:1s5r3", "1:hs", "1:hsd", "1:b1", "+", "-", "1+", "1-", "7.1", "8", "1.0", ":*3", ":x", ":cmdlist"),
)


def switch_on_again(rig: PpsmcRig) -> None:
    """Cycle the power, and connect."""
    rig.unit.set_power(on=False)
    rig.unit.set_power(on=True)
    rig.wait(120)
    rig.client = Client(rig)


@pytest.mark.parametrize("firmware", ["1.1.165", "1.2"])
def test_ppsmc(firmware: str) -> None:
    for op in sorted({*COMMANDS, *PROGRAM_NAMES, "*idn?", "nonsense"}):
        rig = PpsmcRig({"axes": 2, "firmware": firmware})
        rig.client.send("echo1")
        for name in cased(op):
            for argument in (*ARGUMENTS, *PPSMC_ARGUMENTS):
                if rig.client.lost:
                    switch_on_again(rig)
                rig.client.send(f"{name}{argument}")
                rig.wait(0.002)
        rig.client.send("q", "stop", "unlock", "echo1")
        rig.wait(60)
        if rig.client.lost:
            switch_on_again(rig)
        other = Client(rig)  # the next command of the first one may sleep for years
        other.ask("?v")
        assert other.raw, op
        switch_on_again(rig)
        assert rig.client.ask("?p1"), op


def test_ppsmc_programs() -> None:
    for op in sorted(PROGRAM_NAMES):
        for argument in ARGUMENTS[::4] + PPSMC_ARGUMENTS[::2]:
            rig = PpsmcRig()
            rig.client.send("echo1", f"1{op}{argument}", f"{op}{argument}", "nl", "start")
            rig.wait(1)
            rig.client.send("stop")
            rig.wait(10)
            rig.client.raw = b""
            rig.client.send("?p1")
            assert rig.client.raw or rig.client.lost, (op, argument)


# SMC30: a string has one answer, Y, R, B, E or a value; a busy device accepts only K, F and Z.

SMC30_OPS = [
    "f",
    "I",
    "G",
    "+",
    "-",
    "G+",
    "G-",
    "g+",
    "g-",
    "H+",
    "H-",
    "N",
    "NA",
    "CS",
    "CR",
    "CT",
    "RT",
    "RS",
    "R",
    "S",
    "T",
    "r",
    "s",
    "t",
    "A",
    "C",
    "U",
    "UA",
    "W",
    "WA",
    "D",
    "DA",
    "J",
    "JC",
    "JCA",
    "JS",
    "RET",
    "L",
    "con=",
    "PRINT",
    "IF",
    "INPUT",
    "AO",
    "CO",
    "PO",
    "PE",
    "PX",
    "E",
    "K",
    "Z",
    "M",
    "X",
    "F",
    "Q",
    "?",
    "V",
    "V1",
    "V2",
    "VS",
    "VT",
    "VR",
    "VA",
    "VTP",
    "MS",
    "MR",
    "Y",
    "B",
]
SMC30_ARGUMENTS = (
    *("1.1", "1.2.3", "11.91", "X.A2>100", "A1<5.X", "1=1.5", "1>5.6", "(R1)", "(R)", "A1.1-2", "A9.1-2", "=R1+R2"),
    *("=1/0", "=R(R1)", f"={HUGE}", "=INPUT1.1", "=INPUT1.1.1-5", '1.1."text"', "255.1.R1", "R1<R2", "R1<>", "1.99999"),
)


def test_smc30() -> None:
    for op in SMC30_OPS:
        rig = Smc30Rig()
        for name in cased(op):
            for argument in (*ARGUMENTS, *SMC30_ARGUMENTS):
                answer = rig.raw(f"{name}{argument}\r".encode("latin-1"))
                if not answer:
                    rig.wait(3)
                rig.raw(b"Z\r")
                rig.wait(0.001)
        rig.wait(3)
        assert rig.raw(b"Z\rV1\r").startswith(b"Y\rV"), op


def test_smc30_programs() -> None:
    for op in SMC30_OPS:
        for argument in ARGUMENTS[1::3] + SMC30_ARGUMENTS:
            rig = Smc30Rig()
            rig.raw(f"PO\r{op}{argument}\rE\r".encode("latin-1"))
            rig.wait(0.5)
            rig.raw(b"K\r")
            rig.wait(1)
            assert rig.raw(b"V1\r").startswith(b"V"), (op, argument)


# CiA 402: every object by SDO, and every first byte of a request.


def sdo_answers(bench: CanBench) -> bool:
    """Whether the drive answers a plain query, after its node was reset."""
    bench.send(0x000, b"\x81\x01")
    bench.wait(600)
    return bench.read(0x1000) == 0x0002_0192


def test_cia402_objects() -> None:
    bench = CanBench()
    keys = sorted(bench.drive.station.drive._dictionary.entries)
    found = sorted({index for index, _ in keys})
    values = (0, 1, 0x7F, 0x80, 0xFFFF_FFFF, 0x8000_0000, 0x7FFF_FFFF)
    for index in found:
        subs = sorted({sub for each, sub in keys if each == index} | {0, 1, 254})
        for sub in subs:
            head = index.to_bytes(2, "little") + bytes([sub])
            requests = [b"\x40" + head + bytes(4)]
            requests += [
                bytes([0x23 | size << 2]) + head + value.to_bytes(4, "little") for size in range(4) for value in values
            ]
            for request in requests:
                before = len(bench.frames)
                bench.send(0x601, request)
                bench.wait(0.5)
                assert len(bench.frames) > before, request.hex()
    assert sdo_answers(bench)


def test_cia402_requests() -> None:
    bench = CanBench()
    for first in range(256):
        for tail in (bytes(7), b"\xff" * 7, bytes.fromhex("41600000000000"), bytes.fromhex("08100000ff0000")):
            for size in (8, 3, 0):
                bench.send(0x601, (bytes([first]) + tail)[:size])
            bench.wait(0.5)
        bench.send(0x000, bytes([first, 1]))
        bench.send(0x080, bytes([first]))
        bench.send(0x201, bytes([first]) * (first % 9))
        bench.wait(1)
    assert sdo_answers(bench)


# All makes: any number of commands may come at once.


@pytest.mark.parametrize(
    ("model", "command", "answer"),
    [
        ("smc4000", b"MG 1{F1.0}\r", b" 1\r\n:"),
        ("smc4000", b"MG 1{F1.0};", b" 1\r\n:"),
        ("smc2000", b"MG 1{F1.0}\r", b" 1\r\n:"),
        ("shrc203", b"I:\r\n", b"0\r\n"),
        ("ppsmc", b"?us\r\n", b"0\r\n"),
        ("smc30", b"V1\r", b"V+0\r"),
    ],
)
def test_thousands_of_commands_in_one_write_are_all_answered(model: str, command: bytes, answer: bytes) -> None:
    clock, answers = EventQueue(), bytearray()
    unit = find_simulator(model).build_controller(clock, {"echo": False} if model == "smc2000" else {})
    line = unit.connect(unit.port_names[0], answers.extend, lambda: None)
    answers.clear()
    line.receive_bytes(command * 3000)
    clock.run_until_ns(clock.now_ns() + 1_000_000_000)
    assert answers == answer * 3000
