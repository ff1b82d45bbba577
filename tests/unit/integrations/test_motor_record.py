"""The motor record against sequences of its documents and of reports of errors: `motor_record.jsonl`."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from integrations.epics.fields import FIELDS
from integrations.epics.readings import AxisReading
from integrations.epics.record import MotorRecord
from orchestrator.model.state import RetargetAbility
from tutti import AxisInfo

VECTORS = [
    json.loads(line)
    for line in (Path(__file__).parents[2] / "contract" / "vectors" / "motor_record.jsonl").read_text().splitlines()
]
AXIS = AxisInfo(
    name="gantry.x",
    make="smc4000",
    motor="X",
    unit="mm",
    kind="linear",
    resolution=0.001,
    digits=3,
    least=-10,
    most=100,
    velocity=10,
    acceleration=20,
    jerk=None,
    wrap=None,
    referenced=True,
    description="",
    retarget=RetargetAbility(way="brake", within_s=0.1),
)


class RecordedDriver:
    """Writes down what it is asked for."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def move(self, target: float, velocity: float) -> None:
        self.calls.append(f"move {target:.10g} at {velocity:g}")

    def jog(self, velocity: float) -> None:
        self.calls.append(f"jog {velocity:g}")

    def home(self) -> None:
        self.calls.append("home")

    def set_position(self, position: float) -> None:
        self.calls.append(f"set {position:.10g}")

    def enable(self, *, on: bool) -> None:
        self.calls.append(f"enable {on}")

    def stop(self) -> None:
        self.calls.append("stop")


class Sequence:
    """Plays the steps of a vector: `put`, `at` (a reading), `end` (of the operation), and what is then expected."""

    def __init__(self) -> None:
        self.driver = RecordedDriver()
        self.record = MotorRecord(AXIS, AxisReading(0.0, 0.0), 2.0, self.driver)
        self.waiting: list[str] = []
        self.ended: list[tuple[str, str | None]] = []
        self.history = {name: [str(self.record.values[name])] for name in FIELDS}
        for name in FIELDS:
            self.record.follow(name, self._note(name))

    def _note(self, name: str) -> Callable[[Any, float | None], None]:
        def note(value: Any, _: float | None) -> None:
            if self.history[name][-1] != str(value):
                self.history[name].append(str(value))

        return note

    def put(self, name: str, value: Any) -> None:
        def done(error: str | None) -> None:
            self.waiting.remove(name)
            self.ended.append((name, error))

        self.waiting.append(name)
        self.record.put(name, value, done)

    def at(self, position: float, more: dict[str, Any] | None = None) -> None:
        self.record.read(AxisReading(position, position, **(more or {})))

    def end(self, error: str | None = None) -> None:
        self.record.end(error)

    def calls(self, *wanted: str) -> None:
        calls, self.driver.calls = self.driver.calls, []
        assert calls == list(wanted)

    def expect(self, values: dict[str, Any]) -> None:
        shown = {name: self.record.values[name] for name in values}
        assert shown == pytest.approx(values, abs=1e-9)

    def check_waiting(self, *names: str) -> None:
        assert self.waiting == list(names)

    def check_ended(self, *wanted: str) -> None:
        """Puts that have ended since the last time, in any order: a name, or a name and a part of the error."""
        ended, self.ended = self.ended, []
        assert sorted(name for name, _ in ended) == sorted(text.partition(":")[0] for text in wanted)
        for text in wanted:
            name, _, part = text.partition(": ")
            assert [error for found, error in ended if found == name and (part in error if error else not part)], ended
            assert sum(error is None for _, error in ended) == sum(": " not in entry for entry in wanted), ended

    def pulses(self, name: str, wanted: str) -> None:
        assert " ".join(self.history[name]) == wanted


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_a_sequence(vector: dict[str, Any]) -> None:
    sequence = Sequence()
    verbs: dict[str, Callable[..., None]] = {
        "put": sequence.put,
        "at": sequence.at,
        "end": sequence.end,
        "calls": sequence.calls,
        "is": sequence.expect,
        "waiting": sequence.check_waiting,
        "ended": sequence.check_ended,
        "pulses": sequence.pulses,
    }
    for verb, *values in vector["steps"]:
        verbs[verb](*values)
    assert not sequence.waiting and not sequence.ended and not sequence.driver.calls, vector["what"]


def test_every_sequence_states_what_it_shows_and_from_where() -> None:
    assert len(VECTORS) >= 60
    assert all(vector["what"] and vector["source"] for vector in VECTORS)
    assert [vector["id"] for vector in VECTORS] == [f"motor-{number:03}" for number in range(1, len(VECTORS) + 1)]
