"""Topics and payloads: what is published for a state, and when.

Two forms. Plain: a retained JSON object for each controller and axis. Sparkplug (topics of Sparkplug B 3.0, chapter 6,
as JSON and not Protobuf): births have all metrics, data the changed ones, deaths come by the broker.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Protocol

from tutti import AxisState, StateReading

SEQUENCES = 256  # of Sparkplug, from 0 again behind 255


@dataclass(frozen=True, slots=True)
class Publication:
    """One message. retained: kept by the broker for clients that come later."""

    topic: str
    payload: str
    retained: bool


class TopicForm(Protocol):
    """Makes messages of states."""

    @property
    def will(self) -> Publication:
        """What the broker publishes when this program is gone."""
        ...

    def begin(self, utc: str) -> list[Publication]:
        """Connected to the broker, perhaps again."""
        ...

    def take(self, reading: StateReading) -> list[Publication]:
        """What a state changes."""
        ...

    def end(self, utc: str) -> list[Publication]:
        """The program ends by itself."""
        ...


@dataclass(slots=True)
class PlainForm:
    """`PREFIX/FLEET/…`: `status` (online, offline), `CONTROLLER` (mode), `CONTROLLER/AXIS`."""

    prefix: str
    fleet: str
    published: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])

    @property
    def will(self) -> Publication:
        return self._make_status("offline")

    def begin(self, utc: str) -> list[Publication]:
        del utc
        self.published.clear()
        return [self._make_status("online")]

    def take(self, reading: StateReading) -> list[Publication]:
        values = {reading.controller: {"mode": reading.mode}}
        for axis, state in reading.axes.items():
            values[axis.replace(".", "/")] = describe_axis(state, offline=reading.mode == "offline")
        messages: list[Publication] = []
        for name, value in values.items():
            if self.published.get(name) != value:
                self.published[name] = value
                payload = json.dumps({**value, "utc": reading.utc})
                messages.append(Publication(f"{self.prefix}/{self.fleet}/{name}", payload, retained=True))
        return messages

    def end(self, utc: str) -> list[Publication]:
        del utc
        return [self.will]

    def _make_status(self, status: str) -> Publication:
        return Publication(f"{self.prefix}/{self.fleet}/status", json.dumps({"status": status}), retained=True)


@dataclass(slots=True)
class SparkplugForm:
    """`spBv1.0/GROUP/TYPE/FLEET[/CONTROLLER]`: the fleet is an edge node, each controller a device."""

    group: str
    fleet: str
    births: int = 0
    sequence: int = 0
    metrics: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])
    alive: set[str] = field(default_factory=set[str])

    @property
    def will(self) -> Publication:
        # The death of a connection names the birth that it ends; it is made before that.
        payload = json.dumps({"metrics": [{"name": "bdSeq", "value": self.births % SEQUENCES}]})
        return Publication(f"spBv1.0/{self.group}/NDEATH/{self.fleet}", payload, retained=False)

    def begin(self, utc: str) -> list[Publication]:
        self.sequence = 0
        self.metrics.clear()
        self.alive.clear()
        birth = [{"name": "bdSeq", "value": self.births % SEQUENCES}, {"name": "Node Control/Rebirth", "value": False}]
        self.births += 1
        return [self._make("NBIRTH", "", birth, utc)]

    def take(self, reading: StateReading) -> list[Publication]:
        device, is_offline = reading.controller, reading.mode == "offline"
        if is_offline:
            if device not in self.alive:
                return []
            self.alive.discard(device)
            self.metrics.pop(device, None)
            return [self._make("DDEATH", device, [], reading.utc)]
        values = dict(list_metrics(reading))
        known_values = self.metrics.get(device)
        self.metrics[device] = values
        if device not in self.alive:
            self.alive.add(device)
            return [self._make("DBIRTH", device, make_metrics(values), reading.utc)]
        new_values = {
            name: value for name, value in values.items() if known_values is None or known_values.get(name) != value
        }
        return [self._make("DDATA", device, make_metrics(new_values), reading.utc)] if new_values else []

    def end(self, utc: str) -> list[Publication]:
        del utc
        self.births -= 1  # the death of the birth that was
        death = self.will
        self.births += 1
        return [death]

    def _make(self, kind: str, device: str, metrics: list[dict[str, Any]], utc: str) -> Publication:
        topic = "/".join(part for part in ("spBv1.0", self.group, kind, self.fleet, device) if part)
        content = {"timestamp": find_ms(utc), "metrics": metrics, "seq": self.sequence}
        self.sequence = (self.sequence + 1) % SEQUENCES
        return Publication(topic, json.dumps(content), retained=False)


def describe_axis(state: AxisState, *, offline: bool) -> dict[str, Any]:
    """What is published of an axis."""
    return {
        "position": state.position,
        "unit": state.unit,
        "moving": state.moving,
        "referenced": state.referenced,
        "enabled": state.enabled,
        "limit": state.limit,
        "fault": state.fault,
        "offline": offline,
    }


def list_metrics(reading: StateReading) -> Iterator[tuple[str, Any]]:
    """The metrics of a controller by name: `mode`, `AXIS/position`."""
    yield "mode", reading.mode
    for axis, state in reading.axes.items():
        name = axis.partition(".")[2]
        for key, value in describe_axis(state, offline=False).items():
            if key != "offline":
                yield f"{name}/{key}", value


def make_metrics(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Metrics with the data types of Sparkplug."""
    types = {bool: "Boolean", float: "Double", int: "Double"}
    return [
        {"name": name, "dataType": types.get(type(value), "String"), "value": value} for name, value in values.items()
    ]


def find_ms(utc: str) -> int:
    """RFC 3339 as ms since 1970."""
    return round(datetime.fromisoformat(utc).timestamp() * 1000)
