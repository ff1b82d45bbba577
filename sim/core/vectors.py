"""Runs test vectors against a fresh simulated controller in virtual time.

The format is that of `tests/contract/vectors/*.jsonl`: one JSON object a line with `options`, `given`, `setup`,
`send` and `expect`. Wire and firmware take no time, so every outcome is exact.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, cast

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.queue import EventQueue
from sim.core.controller import Connection, Simulator, VectorBench

QUIET_NS = 200_000_000  # the end of a reply: that long without a byte
REST_LIMIT_NS = 600 * NS_PER_S
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")

Vector = Mapping[str, Any]


class VectorFileError(ValueError):
    """A vector file that cannot be read: names file, line and what is wrong."""


@dataclass(frozen=True, slots=True)
class Failure:
    """One thing that did not hold: what was sent, expected and received."""

    vector: str
    sent: str
    expected: str
    received: str
    lines: str = ""


@dataclass(slots=True)
class VectorReport:
    """What came of a file of vectors."""

    passed: list[str] = field(default_factory=list[str])
    failures: dict[str, list[Failure]] = field(default_factory=dict[str, list[Failure]])


@cache
def simulator(model: str) -> Simulator:
    """The simulator that the entry points of `tutti.simulators` give for `model`; `ValueError` lists the known ones."""
    known = entry_points(group="tutti.simulators")
    for entry in known:
        if entry.name == model:
            return cast(Simulator, entry.load())
    names = ", ".join(sorted(entry.name for entry in known))
    raise ValueError(f"no simulator for model {model!r}; known models: {names}")


def read_vectors(path: Path) -> list[Vector]:
    """The vectors of a JSON Lines file. Raises `VectorFileError`."""
    vectors: list[Vector] = []
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise VectorFileError(f"{path}: {error.strerror}; give a file of vectors in JSON Lines") from None
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            vector = json.loads(line)
        except json.JSONDecodeError as error:
            raise VectorFileError(f"{path}:{number}: not JSON: {error}") from None
        if not isinstance(vector, dict) or "id" not in vector or "expect" not in vector:
            raise VectorFileError(f"{path}:{number}: a vector is an object with at least `id` and `expect`")
        vectors.append(cast(Vector, vector))
    return vectors


def check_file(model: str, path: Path, only: str | None = None) -> VectorReport:
    """Run the vectors of `path` (or the one with id `only`) against simulator `model`.

    Raises `VectorFileError` for the file, `ValueError` for an unknown model or id.
    """
    subject = simulator(model)
    vectors = [vector for vector in read_vectors(path) if only in (None, vector["id"])]
    if only is not None and not vectors:
        raise ValueError(f"{path}: no vector has the id {only!r}")
    report = VectorReport()
    for vector in vectors:
        failures = run_vector(subject, vector)
        if failures:
            report.failures[vector["id"]] = failures
        else:
            report.passed.append(vector["id"])
    return report


def run_vector(subject: Simulator, vector: Vector) -> list[Failure]:
    """What does not hold of one vector. An error inside the simulator is a failure too."""
    run = _Run(subject, vector)
    try:
        run.play()
    except Exception as error:
        run.fail(str(vector.get("send", "")), "no error", f"{type(error).__name__}: {error}")
    return run.failures


class _Run:
    """One vector on one fresh controller."""

    def __init__(self, subject: Simulator, vector: Vector) -> None:
        self.vector = vector
        self.failures: list[Failure] = []
        self.clock = EventQueue()
        self.bench: VectorBench = subject.vector_bench(self.clock, vector.get("options", {}))
        self.controller = self.bench.controller
        self.received = bytearray()
        self.last_byte_ns = 0
        self.connection: Connection = self._connect()

    def _connect(self) -> Connection:
        return self.controller.connect(self.bench.port, self._take, lambda: None)

    def _take(self, data: bytes) -> None:
        self.received += data
        self.last_byte_ns = self.clock.now_ns()

    def fail(self, sent: str, expected: object, received: object) -> None:
        identity, lines = str(self.vector["id"]), str(self.vector.get("lines", ""))
        self.failures.append(Failure(identity, sent, str(expected), str(received), lines))

    # Exchanges

    def send(self, text: str) -> None:
        self.received.clear()
        self.last_byte_ns = self.clock.now_ns()
        if text:
            self.connection.receive(text.encode("latin-1"))

    def reply(self, quiet_ns: int = QUIET_NS) -> bytes:
        """What has come since `send`, once the controller has been quiet for `quiet_ns`."""
        while self.clock.now_ns() < self.last_byte_ns + quiet_ns:
            self.clock.run_until_ns(self.last_byte_ns + quiet_ns)
        return bytes(self.received)

    def settle(self) -> None:
        limit_ns = self.clock.now_ns() + REST_LIMIT_NS
        while not self.controller.at_rest():
            due_ns = self.clock.next_ns()
            if due_ns is None or due_ns > limit_ns:
                self.clock.run_until_ns(limit_ns)
                return
            self.clock.step()

    def step(self, step: Mapping[str, Any]) -> None:
        """A `setup` step."""
        for name, value in step.items():
            if name == "send":
                self.send(value)
                self.reply()
            elif name == "wait_s":
                self.clock.run_until_ns(self.clock.now_ns() + round(value * NS_PER_S))
            elif name == "until":
                self.settle()
            elif name == "power":
                self.controller.set_power(False)
                self.controller.set_power(True)
                self.connection = self._connect()
            else:
                self.bench.given({name: value})

    # The whole vector

    def play(self) -> None:
        expect: Mapping[str, Any] = self.vector["expect"]
        self.bench.given(self.vector.get("given", {}))
        for step in self.vector.get("setup", []):
            self.step(step)
        self.clock.run_until_ns(self.clock.now_ns())
        before = {axis: self.controller.position(axis) for axis in self.controller.axes}
        motions_before = len(self.controller.motions)
        sent_ns = self.clock.now_ns()
        text = str(self.vector.get("send", ""))
        self.send(text)
        if "after_s" in expect:
            self.clock.run_until_ns(sent_ns + round(expect["after_s"] * NS_PER_S))
            self._compare_motion(text, expect)
        self._compare_reply(text, expect)
        for step in expect.get("steps", []):
            self._expect_step(step)
        if {"rest_position", "displacement", "duration_s"} & expect.keys():
            self.settle()
            self._compare_rest(text, expect, before, motions_before)
        for number, level in expect.get("outputs", {}).items():
            actual = self.controller.output(int(number))
            if actual != level:
                self.fail(text, f"output {number} = {level}", actual)

    def _compare_reply(self, text: str, expect: Mapping[str, Any]) -> None:
        if "moving" in expect:
            self.clock.run_until_ns(self.clock.now_ns())
            for axis, moving in expect["moving"].items():
                actual = self.controller.moving(axis)
                if actual != moving:
                    self.fail(text, f"moving {axis} = {moving}", actual)
        if not {"reply", "refused", "steps", "checksum_char"} & expect.keys():
            return
        reply = self.reply(round(float(expect.get("quiet_s", 0.2)) * NS_PER_S))
        self._match(text, expect, reply)

    def _expect_step(self, step: Mapping[str, Any]) -> None:
        if "reply" not in step and "refused" not in step:
            self.step(step)
            return
        self.send(step.get("send", ""))
        self._match(step.get("send", ""), step, self.reply(round(float(step.get("quiet_s", 0.2)) * NS_PER_S)))

    def _match(self, text: str, expect: Mapping[str, Any], reply: bytes) -> None:
        shown = reply.decode("latin-1")
        if "reply" in expect and not same_reply(expect["reply"], shown, expect.get("reply_like", "exact")):
            self.fail(text, f"{expect['reply']!r} ({expect.get('reply_like', 'exact')})", repr(shown))
        if "refused" in expect and self.bench.refused(reply) != expect["refused"]:
            self.fail(text, "a refusal" if expect["refused"] else "no refusal", repr(shown))
        # The rule is about the bytes that the host sends: the character stands before their terminator.
        if "checksum_char" in expect and not text.removesuffix("\r").endswith(expect["checksum_char"]):
            self.fail(text, f"checksum {expect['checksum_char']!r}", repr(text))

    def _compare_motion(self, text: str, expect: Mapping[str, Any]) -> None:
        for axis, value in expect.get("position", {}).items():
            self._near(text, f"position {axis}", value, self.controller.position(axis), expect.get("tolerance", 1))
        for axis, value in expect.get("velocity", {}).items():
            tolerance = expect.get("tolerance", abs(value) * 0.005)
            self._near(text, f"velocity {axis}", value, self.controller.velocity(axis), tolerance)

    def _compare_rest(
        self, text: str, expect: Mapping[str, Any], before: Mapping[str, float], motions_before: int
    ) -> None:
        tolerance = expect.get("tolerance", 0)
        for axis, value in expect.get("rest_position", {}).items():
            self._near(text, f"rest position {axis}", value, self.controller.position(axis), tolerance)
        for axis, value in expect.get("displacement", {}).items():
            moved = self.controller.position(axis) - before[axis]
            self._near(text, f"displacement {axis}", value, moved, tolerance)
        if "duration_s" in expect:
            motions = self.controller.motions[motions_before:]
            ends = [motion.end_ns for motion in motions if motion.end_ns is not None]
            took_s = (max(ends) - min(motion.start_ns for motion in motions)) / NS_PER_S if ends else 0.0
            self._near(text, "duration_s", expect["duration_s"], took_s, expect.get("tolerance_s", 0.005))

    def _near(self, text: str, what: str, expected: float, actual: float, tolerance: float) -> None:
        if not abs(actual - expected) <= tolerance + 1e-9:
            self.fail(text, f"{what} = {expected} ± {tolerance}", actual)


def same_reply(expected: str, received: str, like: str) -> bool:
    """Whether two replies agree as `reply_like` says: `exact`, `blanks`, `numeric` or `lines`."""
    if like == "blanks":
        return expected.replace(" ", "") == received.replace(" ", "")
    if like == "numeric":
        return _numbers(expected) == _numbers(received) and _rest(expected) == _rest(received)
    if like == "lines":
        return _lines(expected) == _lines(received)
    return expected == received


def _numbers(text: str) -> list[float]:
    return [float(number) for number in _NUMBER.findall(text)]


def _rest(text: str) -> str:
    return "".join(_NUMBER.sub("", text).split())


def _lines(text: str) -> list[str]:
    return [line.strip() for line in re.split(r"[\r\n]+", text.strip())]
