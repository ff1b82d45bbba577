"""What is published for states, and when."""

import json
from typing import Any

from integrations.mqtt.topics import PlainForm, SparkplugForm
from tutti import AxisState, StateReading

UTC = "2026-11-30T10:00:00+00:00"


def reading(position: float = 1.0, mode: Any = "idle") -> StateReading:
    axis = AxisState(
        position=position,
        commanded=position,
        velocity=0.0,
        motor_position=position,
        raw_counts=position,
        commanded_counts=round(position),
        unit="mm",
        moving=False,
        enabled=True,
        referenced=True,
    )
    return StateReading("gantry", mode, {"gantry.x": axis}, None, UTC, None, 0)


def test_a_plain_message_is_retained_and_comes_on_change() -> None:
    form = PlainForm("tutti", "demo")
    assert [message.topic for message in form.begin(UTC)] == ["tutti/demo/status"]
    first = form.take(reading())
    assert [message.topic for message in first] == ["tutti/demo/gantry", "tutti/demo/gantry/x"]
    assert all(message.retained for message in first) and json.loads(first[1].payload)["position"] == 1.0
    assert form.take(reading()) == []
    assert [message.topic for message in form.take(reading(2.0))] == ["tutti/demo/gantry/x"]
    assert json.loads(form.take(reading(2.0, "offline"))[1].payload)["offline"] is True
    assert json.loads(form.will.payload) == {"status": "offline"} and form.end(UTC) == [form.will]


def test_a_broker_that_was_away_gets_everything_again() -> None:
    form = PlainForm("tutti", "demo")
    form.begin(UTC)
    form.take(reading())
    form.begin(UTC)
    assert len(form.take(reading())) == 2


def test_births_data_and_deaths_of_sparkplug() -> None:
    form = SparkplugForm("lab", "demo")
    will = json.loads(form.will.payload)
    (birth,) = form.begin(UTC)
    assert birth.topic == "spBv1.0/lab/NBIRTH/demo"
    # The death that the broker holds ends this very birth.
    assert json.loads(birth.payload)["metrics"][0] == will["metrics"][0] == {"name": "bdSeq", "value": 0}
    (device,) = form.take(reading())
    names = {metric["name"] for metric in json.loads(device.payload)["metrics"]}
    assert device.topic == "spBv1.0/lab/DBIRTH/demo/gantry" and {"mode", "x/position", "x/unit"} <= names
    (data,) = form.take(reading(2.0))
    content = json.loads(data.payload)
    assert data.topic == "spBv1.0/lab/DDATA/demo/gantry" and content["seq"] == 2
    assert content["metrics"] == [{"name": "x/position", "dataType": "Double", "value": 2.0}]
    assert [message.topic for message in form.take(reading(mode="offline"))] == ["spBv1.0/lab/DDEATH/demo/gantry"]
    assert form.take(reading(mode="offline")) == []
    assert form.take(reading())[0].topic == "spBv1.0/lab/DBIRTH/demo/gantry"
    assert form.end(UTC)[0].payload == json.dumps(will)
    assert json.loads(form.will.payload)["metrics"][0]["value"] == 1


def test_sequence_numbers_begin_again_behind_255() -> None:
    form = SparkplugForm("lab", "demo")
    form.begin(UTC)
    numbers = [json.loads(form.take(reading(float(k)))[0].payload)["seq"] for k in range(256)]
    assert numbers == [*range(1, 256), 0]
