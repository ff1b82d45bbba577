"""The language of acme, as the adapter reads the manual."""

import re
from collections.abc import Sequence

from tutti.adapter import ControllerIdentity
from tutti.adapter.lines import (
    LineAxisStatus,
    LineMeaning,
    LineSetting,
    LineStatus,
    LineStep,
    LineTarget,
    LineTraits,
)

_IDENTITY = re.compile(r"ACME (\S+) (\S+) SN (\d+)")
_STATUS = re.compile(r"ST (IDLE|MOVING) ([01])((?: [A-Z]=-?\d+\*?)+)")
_AXIS = re.compile(r" ([A-Z])=(-?\d+)(\*?)")
_KEY = re.compile(r"KEY (\d+)")


class AcmeDialect:
    """Commands and replies. Nothing here writes or waits: the driver does."""

    @property
    def traits(self) -> LineTraits:
        return LineTraits()

    @property
    def spoiler(self) -> bytes:
        """`GO` that was typed before this becomes `GO?`, which the controller does not know."""
        return b"?\n"

    @property
    def stop_bytes(self) -> bytes:
        return b"STOP\n"

    @property
    def stop_search_bytes(self) -> bytes:
        return b"STOP\n"

    def classify_line(self, line: str) -> LineMeaning:
        if line == "ACME READY":
            return "restarted"
        return "ignored" if line in ("STOPPED", "HALTED") else "reply"

    def find_refusal(self, line: str) -> str:
        return line[4:] or "ERR" if line.startswith("ERR") else ""

    def ask_identity(self) -> LineStep:
        return LineStep(b"ID\n", lambda line: _IDENTITY.fullmatch(line) is not None)

    def read_identity(self, lines: Sequence[str]) -> ControllerIdentity | None:
        found = _IDENTITY.fullmatch(lines[-1])
        return None if found is None else ControllerIdentity(f"ACME {found[1]}", found[2], found[3])

    def ask_status(self) -> LineStep:
        return LineStep(b"ST\n", lambda line: _STATUS.fullmatch(line) is not None)

    def read_status(self, lines: Sequence[str]) -> LineStatus | None:
        found = _STATUS.fullmatch(lines[-1])
        if found is None:
            return None
        axes = {name: LineAxisStatus(float(at), moving == "*") for name, at, moving in _AXIS.findall(found[3])}
        return LineStatus("idle" if found[1] == "IDLE" else "moving", axes, is_loaded=found[2] == "1")

    def ask_session(self) -> LineStep:
        return LineStep(b"KEY\n", lambda line: _KEY.fullmatch(line) is not None)

    def read_session(self, lines: Sequence[str]) -> int | None:
        found = _KEY.fullmatch(lines[-1])
        return None if found is None else int(found[1])

    def write_session(self, number: int) -> Sequence[LineStep]:
        return [LineStep(f"KEY {number}\n".encode(), lambda line: line == f"KEY {number}")]

    def settings(self) -> Sequence[LineSetting]:
        return ()

    def load_move(self, targets: Sequence[LineTarget]) -> Sequence[LineStep]:
        return [_command(f"LOAD {_format_target(each)}") for each in targets]

    def start_move(self) -> LineStep:
        return _command("GO")

    def finish_stop(self) -> Sequence[LineStep]:
        return [LineStep(b"STOP\n"), LineStep(until=("idle",))]

    def search_reference(self, motors: Sequence[str], timeout_s: float) -> Sequence[LineStep]:
        return [_command(f"HOME {''.join(motors)}"), LineStep(until=("idle",), timeout_s=timeout_s)]

    def begin_jog(self, target: LineTarget) -> Sequence[LineStep]:
        return [_command(f"JOG {_format_target(target)}")]

    def stop_jog(self, motor: str) -> bytes:
        return f"HALT {motor}\n".encode()

    def switch_motors(self, motors: Sequence[str], *, on: bool) -> Sequence[LineStep]:
        return ()

    def clear_alarm(self) -> Sequence[LineStep]:
        return ()


def _command(text: str) -> LineStep:
    return LineStep(f"{text}\n".encode(), lambda line: line == "OK")


def _format_target(target: LineTarget) -> str:
    return f"{target.motor} {target.position:.0f} {target.velocity:.6f} {target.acceleration:.6f}"
