"""Run test vectors against a fresh simulated controller in virtual time.

The format is that of `tests/contract/vectors/*.jsonl`: one JSON object a line with `options`, `given`, `setup`, `send`
and `expect`. Cable and firmware take no time, so every outcome is exact.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, cast

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.queue import EventQueue
from orchestrator.model.errors import TuttiError
from orchestrator.model.plugins import PluginListing, list_plugins, load_plugin
from sim.core.controller import PortConnection, Simulator, VectorBench

QUIET_NS = 200_000_000  # a reply ends after this time without a byte
REST_LIMIT_NS = 600 * NS_PER_S
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")

Vector = Mapping[str, Any]


class VectorFileError(TuttiError, ValueError):
    """A vector file that cannot be read; the message names file, line and error."""


@dataclass(frozen=True, slots=True)
class VectorFailure:
    """One failed expectation: the bytes sent, expected and received."""

    vector: str
    sent: str
    expected: str
    received: str
    lines: str = ""


@dataclass(slots=True)
class VectorReport:
    """Results of a file of vectors."""

    passed: list[str] = field(default_factory=list[str])
    failures: dict[str, list[VectorFailure]] = field(default_factory=dict[str, list[VectorFailure]])


# What a plug-in must have. A simulator of another project need not derive from `Simulator`.
_MEMBERS = ("model", "build_controller", "options_model", "make_options", "vector_bench")


@cache
def find_simulator(model: str) -> Simulator:
    """Return the simulator that the entry points of `tutti.simulators` give for `model`.

    Raises `UnknownPlugin`, which lists the known ones, or `PluginError`; both are a `ValueError`.
    """
    return cast(Simulator, load_plugin("tutti.simulators", model, _MEMBERS))


def list_simulators() -> list[PluginListing]:
    """Return all installed simulators, with the reason where one cannot be used."""
    return list_plugins("tutti.simulators", _MEMBERS)


def read_vectors(path: Path) -> list[Vector]:
    """Read the vectors of a JSON Lines file. Raises `VectorFileError`."""
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
    subject = find_simulator(model)
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


def run_vector(subject: Simulator, vector: Vector) -> list[VectorFailure]:
    """Return the failed expectations of one vector. An error inside the simulator is a failure too."""
    run = _VectorRun(subject, vector)
    try:
        run.run_all()
    except Exception as error:
        run.add_failure(str(vector.get("send", "")), "no error", f"{type(error).__name__}: {error}")
    return run.failures


class _VectorRun:
    """One vector on one fresh controller."""

    def __init__(self, subject: Simulator, vector: Vector) -> None:
        self.vector = vector
        self.failures: list[VectorFailure] = []
        self.clock = EventQueue()
        self.bench: VectorBench = subject.vector_bench(self.clock, vector.get("options", {}))
        self.controller = self.bench.controller
        self.received = bytearray()
        self.last_byte_ns = 0
        self.connection: PortConnection = self._open_port()

    def _open_port(self) -> PortConnection:
        return self.controller.connect(self.bench.port_name, self._collect_bytes, lambda: None)

    def _collect_bytes(self, data: bytes) -> None:
        self.received += data
        self.last_byte_ns = self.clock.now_ns()

    def add_failure(self, sent: str, expected: object, received: object) -> None:
        identity, lines = str(self.vector["id"]), str(self.vector.get("lines", ""))
        self.failures.append(VectorFailure(identity, sent, str(expected), str(received), lines))

    # Exchange of bytes

    def send_text(self, text: str) -> None:
        self.received.clear()
        self.last_byte_ns = self.clock.now_ns()
        if text:
            self.connection.receive_bytes(text.encode("latin-1"))

    def collect_reply(self, quiet_ns: int = QUIET_NS) -> bytes:
        """Return the bytes received since `send_text`, once the controller has been quiet for `quiet_ns`."""
        while self.clock.now_ns() < self.last_byte_ns + quiet_ns:
            self.clock.run_until_ns(self.last_byte_ns + quiet_ns)
        return bytes(self.received)

    def wait_for_rest(self) -> None:
        limit_ns = self.clock.now_ns() + REST_LIMIT_NS
        while not self.controller.at_rest():
            due_ns = self.clock.next_ns()
            if due_ns is None or due_ns > limit_ns:
                self.clock.run_until_ns(limit_ns)
                return
            self.clock.make_next_call()

    def run_step(self, step: Mapping[str, Any]) -> None:
        """Run a `setup` step."""
        for name, value in step.items():
            if name == "send":
                self.send_text(value)
                self.collect_reply()
            elif name == "wait_s":
                self.clock.run_until_ns(self.clock.now_ns() + round(value * NS_PER_S))
            elif name == "until":
                self.wait_for_rest()
            elif name == "power":
                self.controller.set_power(on=False)
                self.controller.set_power(on=True)
                self.connection = self._open_port()
            else:
                self.bench.apply_given({name: value})

    # The whole vector

    def run_all(self) -> None:
        expect: Mapping[str, Any] = self.vector["expect"]
        self.bench.apply_given(self.vector.get("given", {}))
        for step in self.vector.get("setup", []):
            self.run_step(step)
        self.clock.run_until_ns(self.clock.now_ns())
        positions_before = {axis: self.controller.position(axis) for axis in self.controller.axis_names}
        motions_before = len(self.controller.commanded_motions)
        sent_ns = self.clock.now_ns()
        text = str(self.vector.get("send", ""))
        self.send_text(text)
        if "after_s" in expect:
            self.clock.run_until_ns(sent_ns + round(expect["after_s"] * NS_PER_S))
            self._compare_motion(text, expect)
        self._compare_reply(text, expect)
        for step in expect.get("steps", []):
            self._expect_step(step)
        if {"rest_position", "displacement", "duration_s"} & expect.keys():
            self.wait_for_rest()
            self._compare_rest(text, expect, positions_before, motions_before)
        for number, level in expect.get("outputs", {}).items():
            actual = self.controller.output_level(int(number))
            if actual != level:
                self.add_failure(text, f"output {number} = {level}", actual)

    def _compare_reply(self, text: str, expect: Mapping[str, Any]) -> None:
        if "moving" in expect:
            self.clock.run_until_ns(self.clock.now_ns())
            for axis, is_moving in expect["moving"].items():
                actual = self.controller.is_moving(axis)
                if actual != is_moving:
                    self.add_failure(text, f"moving {axis} = {is_moving}", actual)
        if not {"reply", "refused", "steps", "checksum_char"} & expect.keys():
            return
        reply = self.collect_reply(round(float(expect.get("quiet_s", 0.2)) * NS_PER_S))
        self._check_reply(text, expect, reply)

    def _expect_step(self, step: Mapping[str, Any]) -> None:
        if "reply" not in step and "refused" not in step:
            self.run_step(step)
            return
        self.send_text(step.get("send", ""))
        self._check_reply(
            step.get("send", ""), step, self.collect_reply(round(float(step.get("quiet_s", 0.2)) * NS_PER_S))
        )

    def _check_reply(self, text: str, expect: Mapping[str, Any], reply: bytes) -> None:
        reply_text = reply.decode("latin-1")
        if "reply" in expect and not same_reply(expect["reply"], reply_text, expect.get("reply_like", "exact")):
            self.add_failure(text, f"{expect['reply']!r} ({expect.get('reply_like', 'exact')})", repr(reply_text))
        if "refused" in expect and self.bench.is_refusal(reply) != expect["refused"]:
            self.add_failure(text, "a refusal" if expect["refused"] else "no refusal", repr(reply_text))
        # The rule concerns the bytes that the host sends: the character precedes their terminator.
        if "checksum_char" in expect and not text.removesuffix("\r").endswith(expect["checksum_char"]):
            self.add_failure(text, f"checksum {expect['checksum_char']!r}", repr(text))

    def _compare_motion(self, text: str, expect: Mapping[str, Any]) -> None:
        for axis, value in expect.get("position", {}).items():
            self._check_within(
                text, f"position {axis}", value, self.controller.position(axis), expect.get("tolerance", 1)
            )
        for axis, value in expect.get("velocity", {}).items():
            tolerance = expect.get("tolerance", abs(value) * 0.005)
            self._check_within(text, f"velocity {axis}", value, self.controller.velocity(axis), tolerance)

    def _compare_rest(
        self, text: str, expect: Mapping[str, Any], before: Mapping[str, float], motions_before: int
    ) -> None:
        tolerance = expect.get("tolerance", 0)
        for axis, value in expect.get("rest_position", {}).items():
            self._check_within(text, f"rest position {axis}", value, self.controller.position(axis), tolerance)
        for axis, value in expect.get("displacement", {}).items():
            moved_position = self.controller.position(axis) - before[axis]
            self._check_within(text, f"displacement {axis}", value, moved_position, tolerance)
        if "duration_s" in expect:
            motions = self.controller.commanded_motions[motions_before:]
            ends = [motion.end_ns for motion in motions if motion.end_ns is not None]
            took_s = (max(ends) - min(motion.start_ns for motion in motions)) / NS_PER_S if ends else 0.0
            self._check_within(text, "duration_s", expect["duration_s"], took_s, expect.get("tolerance_s", 0.005))

    def _check_within(self, text: str, what: str, expected: float, actual: float, tolerance: float) -> None:
        if not abs(actual - expected) <= tolerance + 1e-9:
            self.add_failure(text, f"{what} = {expected} ± {tolerance}", actual)


def same_reply(expected: str, received: str, like: str) -> bool:
    """Return whether two replies agree as `reply_like` requires: `exact`, `blanks`, `numeric` or `lines`."""
    if like == "blanks":
        return expected.replace(" ", "") == received.replace(" ", "")
    if like == "numeric":
        return _extract_numbers(expected) == _extract_numbers(received) and _strip_numbers(expected) == _strip_numbers(
            received
        )
    if like == "lines":
        return _split_lines(expected) == _split_lines(received)
    return expected == received


def _extract_numbers(text: str) -> list[float]:
    return [float(number) for number in _NUMBER.findall(text)]


def _strip_numbers(text: str) -> str:
    return "".join(_NUMBER.sub("", text).split())


def _split_lines(text: str) -> list[str]:
    return [line.strip() for line in re.split(r"[\r\n]+", text.strip())]
