"""A live simulator may be woken late while it is not observed; an observer finds everything as if it had not been
late."""

import random
from collections.abc import Callable

import pytest
from unit.sim.desk import Desk

from orchestrator.clock.base import ClockTimer
from orchestrator.clock.queue import EventQueue
from sim.core.controller import FirmwareTiming

SETTINGS = ("PRX=40000", "SPX=50000", "ACX=500000", "DCX=500000", "XT0=2000", "XGO=0", "XLATE=0")
PROGRAM = (
    "#S;XOK=0\r#H;WT 4;JP #H,(XGO=0)&((XT0-TIME)>40)\rXOK=XGO;JP #SHUT,XOK=0\rWT XT0-TIME;BGX;XACT=TIME\r"
    "AMX;XEND=TIME;EN\r#SHUT;XLATE=1;EN\r"
)


class LateQueue(EventQueue):
    """Makes calls as late as they may be, and counts them."""

    made = 0

    def call_at_ns(self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0) -> ClockTimer:  # pyright: ignore[reportIncompatibleMethodOverride]
        def call() -> None:
            self.made += 1
            callback()

        return super().call_at_ns(at_ns + leeway_ns, call)


class PunctualQueue(LateQueue):
    """Counts calls that are made when they are due."""

    def call_at_ns(self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0) -> ClockTimer:
        del leeway_ns
        return super().call_at_ns(at_ns, callback)


def _started(clock: EventQueue) -> Desk:
    """With the program running, a quarter of a second after power-up."""
    desk = Desk(clock=clock, timing=FirmwareTiming(decode_ns=300_000))
    desk.ask("SHX", wait_s=0.01)
    desk.ask("DL", PROGRAM + "\x1a", wait_s=0.01)
    desk.ask("\r".join(SETTINGS), wait_s=0.02)
    desk.ask("XQ #S,0", wait_s=0.01)
    desk.wait(0.25 - clock.now_ns() * 1e-9)
    return desk


@pytest.mark.parametrize("seed", range(20))
def test_a_polled_gate_opens_and_starts_at_the_unchanged_instant(seed: int) -> None:
    """Queried at random instants; the last query opens the gate, or comes too late."""
    asked_s = sorted(random.Random(seed).uniform(0.3, 2.1) for _ in range(6))
    told: list[object] = []
    made: list[int] = []
    for clock in (PunctualQueue(), LateQueue()):
        desk = _started(clock)
        answers: list[str] = []
        for k, at_s in enumerate(asked_s):
            desk.wait(at_s - clock.now_ns() * 1e-9)
            # Its next action comes before the query, as late as it may be woken.
            answers.append(desk.ask("XGO=1" if k == 5 else "MG _HX0,XOK,XLATE,TIME", wait_s=0.001))
        desk.wait(4.0 - clock.now_ns() * 1e-9)
        answers.append(desk.ask("MG XACT,XEND,XLATE,_RPX", wait_s=0.01))
        told.append((answers, [(each.start_ns, each.end_ns) for each in desk.unit.commanded_motions]))
        made.append(clock.made)
    assert told[0] == told[1]
    assert made[1] < made[0] / 3


def test_a_contours_records_follow_each_other_as_they_would_have() -> None:
    """Another thread waits in parallel to its loop, which is not visible, but the next record comes after it, which
    is visible to every observer."""
    contour = (
        "#C;CM X;DT 3;I=0;CD DX[0];I=1\r#P;WC;CD DX[I];I=I+1;JP #P,I<60\rWC;DT 0;CD 0;WC;XEND=TIME;EN\r#D;WT 2;JP #D\r"
    )
    told: list[object] = []
    for clock in (PunctualQueue(), LateQueue()):
        desk = Desk(clock=clock, timing=FirmwareTiming(decode_ns=300_000))
        desk.ask("SHX", "DM DX[60]", wait_s=0.01)
        desk.ask("\r".join(f"DX[{k}]={10 + k % 7}" for k in range(20)), wait_s=0.1)
        desk.ask("DL", contour + "\x1a", wait_s=0.01)
        desk.wait(0.3 - clock.now_ns() * 1e-9)
        desk.ask("XQ #D,1", "XQ #C,0")
        for _ in range(100):
            desk.wait(0.011)
            assert len(desk.unit.commanded_motions) <= 1  # a client queries it, too
        answer = desk.ask("MG XEND,_RPX,_HX0", wait_s=0.01)
        told.append((answer, [(each.start_ns, each.end_ns) for each in desk.unit.commanded_motions]))
    assert told[0] == told[1]


def test_commands_that_came_together_are_answered_when_the_last_one_is() -> None:
    """As late as they may be: the last answer comes at its usual time, and the others not after it."""
    ends: list[int] = []
    wakes: list[int] = []
    for clock in (PunctualQueue(), LateQueue()):
        desk = _started(clock)
        before = clock.made
        desk.line.receive_bytes(b"\r".join(b"V%d=%d" % (k, k) for k in range(9)) + b"\r")
        while desk.heard.count(b":") < 10:  # of them the first is the answer to XQ
            assert clock.make_next_call()
        ends.append(clock.now_ns())
        wakes.append(clock.made - before)
    assert ends[0] == ends[1]
    assert wakes[1] <= wakes[0] / 2


def test_a_stop_on_another_handle_does_not_wait_for_what_may_be_late() -> None:
    slowing: list[int | None] = []
    answered: list[int] = []
    for clock in (PunctualQueue(), LateQueue()):
        desk = _started(clock)
        desk.ask("HX0", wait_s=0.01)
        desk.ask("JGX=20000", "BGX", wait_s=0.2)
        other: list[bytes] = []
        second = desk.unit.connect("tcp", other.append, lambda: None)
        desk.line.receive_bytes(b"\r".join(b"V%d=%d" % (k, k) for k in range(20)) + b"\r")
        desk.wait(0.0005)
        second.receive_bytes(b"ST\r")
        while not other:
            assert clock.make_next_call()
        answered.append(clock.now_ns())
        desk.wait(0.5)
        slowing.append(desk.unit.commanded_motions[-1].slowing_ns)
    assert slowing[0] is not None and slowing[0] == slowing[1]
    assert answered[1] - answered[0] <= 1_000_000
