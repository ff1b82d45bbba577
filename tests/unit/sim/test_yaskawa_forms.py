"""Every op-code of both simulated Yaskawa controllers in every form, also wrong ones: each is answered, none raises."""

from typing import Any

import pytest

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.queue import EventQueue
from sim.yaskawa import SMC2000, SMC4000
from sim.yaskawa.smc2000 import simulator as smc2000
from sim.yaskawa.smc4000 import MODEL

HUGE = "9999999999999999999"
ARGUMENTS = (
    *("", "?", "=", "=?", " ?,?", ",1", "1", "0", "-1", "-", "1,", "1.5", "1e9", "1/0", HUGE, f"-{HUGE}", "$FF", "$"),
    *("X", "XY", "A", "N", "S", "T", "Q", "X,Y", "X=1", "X=?", "X=", "XY=1,2", "*=1", f"X={HUGE}", f"X=-{HUGE}"),
    *("~a", "~a=1", "1,2,3,4", "1,2,3,4,5,6,7,8,9", "?,?,?,?,?", "#A", "#", '"A"', '"', "A[0]", "A[]", "[0]=1", "["),
    *("(", ")", "@", "@ABS[", "@SQR[-1]", "_", "_TPX", "V", "%", "!", "<1>2", "1<2>3", "{F1.1}", "{", "=>-3", "S=>-9"),
    *("A=1,2,3,4<5>2", "\x01", "é"),
)
OPERANDS = ("", "X", "Q", "0", "A1", "9", HUGE)
NOT_ALWAYS_KNOWN = ("AF", "GN", "ZR", "MM", "CC", "CI", "QQ")  # of the other model, or of none
MODELS = [(SMC4000, MODEL, "tcp"), (SMC2000, smc2000.MODEL, "serial")]


def connected(simulator: Any, port: str) -> tuple[EventQueue, Any, bytearray]:
    """A fresh controller that is on, its connection, and what it answers."""
    clock, answers = EventQueue(), bytearray()
    line = simulator.build_controller(clock, {"echo": False}).connect(port, answers.extend, lambda: None)
    for command in ("SHXY", "DM A[5]"):
        line.receive_bytes(command.encode() + b"\r")
    return clock, line, answers


def waits_for(line: Any) -> bool:
    """Whether the port holds back its prompt, or takes what comes as data."""
    entry = line.machine.operator_input.entries["S"]
    return (
        not line.open
        or line.trip is not None
        or line.download is not None
        or line.editor is not None
        or entry.is_enabled
    )


def forms(op: str) -> list[str]:
    return [*(op + each for each in ARGUMENTS), *(f"MG _{op}{each}" for each in OPERANDS), f"V={op}", f"V=_{op}X"]


@pytest.mark.parametrize(("simulator", "model", "port"), MODELS, ids=lambda each: getattr(each, "name", ""))
def test_no_form_of_any_command_ends_a_simulator(simulator: Any, model: Any, port: str):
    for op in sorted({*model.commands, *NOT_ALWAYS_KNOWN}):
        clock, line, answers = connected(simulator, port)
        # The case of an op-code is looked at before what follows it.
        for text in (*forms(op), *(form[:2].lower() + form[2:] for form in forms(op)[::8])):
            if waits_for(line):
                clock, line, answers = connected(simulator, port)
            answers.clear()
            line.receive_bytes(text.encode("latin-1") + b"\r")
            clock.run_until_ns(clock.now_ns() + 2 * NS_PER_MS)
            assert answers.endswith((b":", b"?")) or waits_for(line), text
        # The end of a download, of the editor and of an operator's entry; then motion with whatever was set.
        for text in ("\x1a\x11", "PRX=5000", "BGX", "ST", "HX"):
            line.receive_bytes(text.encode() + b"\r")
            clock.run_until_ns(clock.now_ns() + NS_PER_S)


@pytest.mark.parametrize("first", [0, *(pytest.param(n, marks=pytest.mark.nightly) for n in range(1, 5))])
@pytest.mark.parametrize(("simulator", "model", "port"), MODELS, ids=lambda each: getattr(each, "name", ""))
def test_no_form_of_any_command_in_a_program_ends_a_simulator(simulator: Any, model: Any, port: str, first: int):
    for op in sorted({*model.commands, *NOT_ALWAYS_KNOWN}):
        clock, line, _ = connected(simulator, port)
        for text in forms(op)[first::5]:
            line.receive_bytes(f"HX\rDL\r#A\r{text}\rEN\r\x1aXQ#A\r".encode("latin-1"))
            clock.run_until_ns(clock.now_ns() + 2 * NS_PER_MS)


@pytest.mark.parametrize(("simulator", "model", "port"), MODELS, ids=lambda each: getattr(each, "name", ""))
def test_a_thread_that_a_model_does_not_have_is_refused(simulator: Any, model: Any, port: str):
    clock, line, answers = connected(simulator, port)
    for text in ("HX{}", "XQ0,{}", "MG _XQ{}", "MG _HX{}", "MG _ZS{}"):
        answers.clear()
        line.receive_bytes(f"{text.format(model.threads)}\r".encode())
        clock.run_until_ns(clock.now_ns() + 2 * NS_PER_MS)
        assert answers == b"?", text


@pytest.mark.parametrize("op", ["AF", "GN", "ZR"])
def test_op_codes_that_the_smc4000_does_not_have_are_unknown(op: str):
    clock, line, answers = connected(SMC4000, "tcp")
    for text, code in ((f"{op} 1", "1 "), (f"{op} ?", "1 "), (f"MG _{op}X", "58 ")):
        answers.clear()
        for each in (text, "TC1"):
            line.receive_bytes(each.encode() + b"\r")
        clock.run_until_ns(clock.now_ns() + 10 * NS_PER_MS)
        assert answers.decode().startswith(f"?{code}"), text
