"""Files: an error is named with line, field, the value found and the values allowed."""

from pathlib import Path

import pytest

from orchestrator.model.files import FileError, load_fleet, load_job, parse_document
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Job

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"

FLEET = """schema: tutti.fleet/1
fleet: demo
controllers:
  gantry:
    adapter: smc4000
    link: {kind: tcp, host: 127.0.0.1, port: 2023}
    axes:
      x: {motors: [X], unit: mm, scale: "10000/3", limits: {velocity: 200, acceleration: 1000}, soft_limits: {min: 0, max: "30 cm"}}
      y: {motors: [Y], unit: deg, kind: rotary, wrap: 360, limits: {velocity: 200, acceleration: 1000}}
  other:
    adapter: shrc203
    link: {kind: serial, device: /dev/ttyUSB0}
    axes:
      z: {motors: ["1"], unit: um, limits: {velocity: 1, acceleration: 1}}
    inputs: {door: {number: 1}}
groups: {table: [gantry.x, other.z]}
"""


def problems(text: str, model: type[Fleet] | type[Job] = Fleet) -> str:
    with pytest.raises(FileError) as caught:
        parse_document(text, model, "f.yaml")
    return str(caught.value)


def test_examples_load() -> None:
    fleet = load_fleet(EXAMPLES / "demo.fleet.yaml")
    job = load_job(EXAMPLES / "demo.job.yaml")
    assert fleet.axis_names[0] == "gantry.x"
    assert job.max_start_skew == 10_000_000


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("unit: mm", "unit: furlong", "f.yaml:8: controllers.gantry.axes.x.unit: found 'furlong'; allowed: 'm', 'cm'"),
        ("fleet: demo", "fleet: Demo", "f.yaml:2: fleet: found 'Demo'"),
        ("fleet: demo", "fleet: demo\ncolour: red", "f.yaml:3: colour: unknown field"),
        (
            "kind: tcp",
            "kind: usb",
            "f.yaml:6: controllers.gantry.link: found 'usb' for 'kind'; allowed: 'tcp', 'udp', 'serial'",
        ),
        ('max: "30 cm"', 'max: "30 deg"', "deg is a unit of angle, and the axis is in mm; use one of: m, cm, mm"),
        ('max: "30 cm"', "max: -1", "soft_limits.min (0) is not below max (-1)"),
        ("velocity: 200", "velocity: -1", "f.yaml:8: controllers.gantry.axes.x.limits.velocity: found -1"),
        ('"10000/3"', '"10000/0"', "is not a number"),
        ("port: 2023", "port: 2023, port: 7", "f.yaml:6: controllers.gantry.link.port: is given twice"),
        (
            ", limits: {velocity: 200, acceleration: 1000}, soft",
            ", soft",
            "controllers.gantry.axes.x.limits: is missing",
        ),
        ("[X]", "[X, X2]", "2 motors on one axis are not supported yet"),
        ("motors: [Y]", "motors: [X]", "motor X belongs to axis x and to axis y"),
        ("kind: rotary, ", "", "wrap and shortest_way need `kind: rotary`"),
        ("other.z]", "other.q]", "f.yaml:16: the fleet has no axis other.q"),
        ("{door: {number: 1}}", "{door: {number: 1}, gate: {number: 1}}", "input 1 has two names: door and gate"),
        ("tutti.fleet/1", "tutti.fleet/2", "f.yaml:1: schema: found 'tutti.fleet/2'; allowed: 'tutti.fleet/1'"),
        ("controllers:", "controllers: [", "f.yaml:"),
    ],
)
def test_bad_fleet(old: str, new: str, expected: str) -> None:
    assert old in FLEET
    assert expected in problems(FLEET.replace(old, new, 1))


def test_two_controllers_on_one_port() -> None:
    serial = "{kind: serial, device: /dev/ttyUSB0}"
    text = FLEET.replace("{kind: tcp, host: 127.0.0.1, port: 2023}", serial)
    assert "gantry and other are both on serial /dev/ttyUSB0" in problems(text)


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        ("{do: fly}", "found 'fly' for 'do'; allowed: 'move', 'home'"),
        ("{do: dwell, duration: 5}", "5 is not a duration; write a number and a unit"),
        ("{do: move}", "needs `to` (absolute) or `by` (relative)"),
        ("{do: move, to: {a.x: 1}, by: {a.x: 1}}", "a.x is in both `to` and `by`"),
        ("{do: move, to: {a.x: far}}", "'far' is not a quantity"),
        ("{do: move, to: {a.x: 1}, speed: 2}", "less than or equal to 1"),
        ("{do: wait, input: a.b}", "steps[0].timeout: is missing"),
        ("{name: x}", "needs the field 'do'"),
    ],
)
def test_bad_job(step: str, expected: str) -> None:
    assert expected in problems(f"schema: tutti.job/1\nname: j\nsteps:\n  - {step}\n", Job)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be read: No such file"):
        load_fleet(tmp_path / "none.yaml")


def test_digest_is_of_the_configuration_and_not_of_the_simulation() -> None:
    plain = parse_document(FLEET, Fleet, "f").controllers["gantry"].digest
    simulated = FLEET.replace("adapter: smc4000", "adapter: smc4000\n    simulate: {decode_us: 3}")
    assert parse_document(simulated, Fleet, "f").controllers["gantry"].digest == plain
    assert (
        parse_document(FLEET.replace("velocity: 200", "velocity: 201", 1), Fleet, "f").controllers["gantry"].digest
        != plain
    )
