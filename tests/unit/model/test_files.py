"""Files: an error is named with line, field, the value found and the values allowed."""

import time
from pathlib import Path

import pytest

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, load_fleet, parse_document, read_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.move import Move
from orchestrator.model.templates.template import load_job

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
        (
            "[X]",
            "[X, X2]",
            "axes.x.max_deviation: an axis of two motors needs max_deviation, how far they may be apart",
        ),
        ("[X],", "[X], square: 0.1,", "square applies between the motors of one axis, but this axis has one motor"),
        *(
            ("[X],", f"[X, X2], {fields},", expected)
            for fields, expected in (
                (
                    "max_deviation: 1, may_rack: 1",
                    "may_rack (1) must be above max_deviation and following_error together (1)",
                ),
                (
                    "max_deviation: 1, following_error: 1",
                    "may_rack (2) must be above max_deviation and following_error tog",
                ),
                (
                    "max_deviation: 500 um, square: 1",
                    "square (1) is beyond max_deviation (0.5): the beam would be skewed",
                ),
                (
                    "max_deviation: 1, homing: {speed: 150}",
                    "homing.speed (150) is too fast for may_rack (2): after a fault",
                ),
                ("max_deviation: 1 deg", "deg is a unit of angle"),
            )
        ),
        ("motors: [Y]", "motors: [X]", "motor X belongs to axis x and to axis y"),
        ("kind: rotary, ", "", "wrap and shortest_way need `kind: rotary`"),
        ("other.z]", "other.q]", "f.yaml:16: groups.table[1]: the fleet has no axis other.q; did you mean other.z?"),
        ("{door: {number: 1}}", "{door: {number: 1}, gate: {number: 1}}", "input 1 has two names: door and gate"),
        ("tutti.fleet/1", "tutti.fleet/2", "f.yaml:1: schema: found 'tutti.fleet/2'; allowed: 'tutti.fleet/1'"),
        ("controllers:", "controllers: [", "f.yaml:"),
        *(
            ("groups:", f"positions: {{{position}}}\ngroups:", expected)
            for position, expected in (
                ("gantry: {gantry.x: 1}", "f.yaml:16: positions.gantry: position gantry has the name of a controller"),
                ("table: {gantry.x: 1}", "f.yaml:16: positions.table: position table has the name of a group; rename"),
                ("5mm: {gantry.x: 1}", "positions.5mm: '5mm' is no name of a position; write a-z"),
                ("nan: {gantry.x: 1}", "positions.nan: 'nan' is no name of a position"),
                ("a: {gantry.q: 1}", "f.yaml:16: positions.a.gantry.q: the fleet has no axis gantry.q; did you mean"),
                ("a: {axes: {q: 1}}", "f.yaml:16: positions.a.axes.q: the fleet has no axis q"),
                ("a: {gantry.x: 1 deg}", "f.yaml:16: positions.a.gantry.x: deg is a unit of angle, and the axis is in"),
                ("a: {gantry.x: 301}", "f.yaml:16: positions.a.gantry.x: 301 is beyond the soft limits of gantry.x, 0"),
                ("a: {gantry.x: far}", "f.yaml:16: positions.a.gantry.x: 'far' is not a quantity"),
                ("a: {}", "f.yaml:16: positions.a.axes: found {}; at least 1 must be given"),
                ("a: {gantry.x: 1, note: b}", "f.yaml:16: positions.a.note: unknown field; allowed: axes, description"),
            )
        ),
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
        ("{do: move, to: {a.x: far off}}", "'far off' is not a quantity"),
        ("{do: move, to: {a.x: nan}}", "'nan' is not a quantity"),
        ("{do: move, to: {a.x: 1_000}}", "'1_000' is not a quantity; write 1000"),
        ("{do: move, by: {a.x: sample}}", "'sample' is not a quantity"),
        ("{do: set-position, axes: {a.x: sample}}", "'sample' is not a quantity"),
        ("{do: move, to: {'*': 5}}", "5 for all axes (`*`) must be the name of a position"),
        ("{do: move, to: {a.x: 1}, speed: 2}", 'with a unit it is a speed: "2 mm/s"'),
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


def value_of(written: str) -> object:
    return read_document(f"a: {written}\n", "f").root.value["a"]


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("010", 10),
        ("0o17", 15),
        ("0x1F", 31),
        ("1e3", 1000.0),
        ("+.5", 0.5),
        ("-.inf", float("-inf")),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("0b101", "0b101"),
        ("no", "no"),
        ("on", "on"),
        ("True", True),
        ("~", None),
        ("", None),
        ("2026-11-25", "2026-11-25"),
        ("'10'", "10"),
        ("190:20:30", "190:20:30"),
    ],
)
def test_plain_values_are_those_of_the_core_schema(written: str, value: object) -> None:
    assert value_of(written) == value and type(value_of(written)) is type(value)


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("1:30", "'1:30' is not a quantity; if 90 is meant, write 90"),
        ("1_000", "'1_000' is not a quantity; write 1000"),
        ('"1,5"', "'1,5' is not a quantity; write the number with a point: 1.5"),
        ('"1,5 mm"', "write the number with a point: 1.5 mm"),
        ("1,5", "a comma separates entries; write the number with a point: 1.5"),
        ("on", "'on' is not a quantity"),
        (".nan", "out of range"),
        ("1e300", "out of range; the largest number is 1e+15"),
    ],
)
def test_a_target_that_is_no_number_is_answered_with_what_to_write(target: str, expected: str) -> None:
    text = f"schema: tutti.job/1\nname: j\nsteps:\n  - {{do: move, to: {{gantry.x: {target}}}}}\n"
    assert f"f.yaml:4: steps[0].to.{'5' if target == '1,5' else 'gantry.x'}: " in problems(text, Job)
    assert expected in problems(text, Job)


def test_numbers_take_the_unit_that_is_expected() -> None:
    text = FLEET.replace(
        "velocity: 200, acceleration: 1000}, soft",
        'velocity: "12 m/min", acceleration: "1 m/s^2", jerk: "5 m/s³"}, soft',
    )
    text = text.replace(
        "wrap: 360, limits: {velocity: 200,",
        'wrap: "1 rev", homing: {speed: "1 rpm", timeout_s: "2 min"}, limits: {velocity: "0.5 rev/s",',
    )
    axes = parse_document(text, Fleet, "f").controllers["gantry"].axes
    assert (axes["x"].limits.velocity, axes["x"].limits.acceleration, axes["x"].limits.jerk) == (200, 1000, 5000)
    assert (axes["y"].limits.velocity, axes["y"].homing.speed, axes["y"].homing.timeout_s) == (180, 6, 120)
    move = parse_document(
        "schema: tutti.job/1\nname: j\nsteps: [{do: move, to: {a.x: 1}, speed: 50%}]", Job, "f"
    ).steps[0]
    assert isinstance(move, Move) and move.speed == 0.5


def test_all_mistakes_of_a_file_are_reported_in_one_go() -> None:
    text = FLEET
    for old, new in (
        ("fleet: demo", "fleet: Demo"),
        ("port: 2023", "port: 202300"),
        ("velocity: 200", 'velocity: "200 mm"'),
        ("acceleration: 1000", "acceleration: 1_000"),
        ('"30 cm"', '"30 deg"'),
        ("wrap: 360", "wrap: 360, shortest_way: on, brake: {output: off}"),
        ("[Y]", "[X]"),
        ("number: 1", "nmuber: 1"),
        ("other.z]", "other.q]"),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    found = problems(text).splitlines()
    for expected in (
        "f.yaml:2: fleet: found 'Demo'; an id may contain only a-z, 0-9, _ and -",
        "f.yaml:6: controllers.gantry.link.port: found 202300; must be at most 65535",
        "f.yaml:8: controllers.gantry.axes.x.limits.velocity: '200 mm' is not in a unit of mm/s; write e.g. \"200 mm/s\"",
        "f.yaml:8: controllers.gantry.axes.x.limits.acceleration: '1_000' is not a quantity; write 1000",
        "f.yaml:8: controllers.gantry.axes.x.soft_limits: deg is a unit of angle",
        "f.yaml:9: controllers.gantry.axes.y.shortest_way: found 'on'; write true",
        "f.yaml:9: controllers.gantry.axes.y.brake.output: the controller has no output off",
        "f.yaml:9: controllers.gantry.axes.y.motors[0]: motor X belongs to axis x and to axis y",
        "f.yaml:15: controllers.other.inputs.door.number: is missing",
        "f.yaml:15: controllers.other.inputs.door.nmuber: unknown field; did you mean number? allowed: active, number",
        "f.yaml:16: groups.table[1]: the fleet has no axis other.q; did you mean other.z?",
    ):
        assert [line for line in found if line.startswith(expected)], (expected, found)
    assert len(found) == 11


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: 1\n<<: {b: 2}\n", "f:2: merge keys (`<<`) are not used"),
        ("a: 1\nb: 2\na: 3\n", "f:3: a: is given twice; the first one is in line 1"),
        ("a: !!float 1\n", "f:1: a: tags are not used"),
        ("? [a]\n: 1\n", "f:1: a key must be a word"),
        ("a: 1\n---\nb: 1\n", "f:2: a second document begins here"),
        ("a: *b\n", "f:1: a: alias *b has no anchor &b before it"),
        ("a: \x01", "f:1: not YAML: control characters are not allowed"),
    ],
)
def test_what_yaml_has_and_files_do_not_use(text: str, expected: str) -> None:
    with pytest.raises(FileError) as caught:
        read_document(text, "f")
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"a: 1\nb: 5 \xb5m\n", ":2: byte 0xb5 is not UTF-8 text; save the file as UTF-8"),
        ("a: 1".encode("utf-16"), ":1: is UTF-16 text; save it as UTF-8"),
        (b"", "must be a mapping that starts with `schema:`"),
        (b"\xef\xbb\xbfa: 1", "schema: is missing"),
    ],
)
def test_other_encodings_get_a_message(data: bytes, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(data)
    with pytest.raises(FileError) as caught:
        load_fleet(path)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("scale", "expected"),
    [
        ("1e300", "'1e+300' is not a number"),
        ('"1e99999999"', "'1e99999999' is not a number"),
        ("1e14", "must be from 1/1000000 to 1000000000000"),
        ("-5", "must be above 0 (use `sign: -1`"),
        ("1e8", "soft_limits.max (30 cm) is 3e+10 counts; positions are within ±2147483648 counts"),
    ],
)
def test_scales_and_counts_have_bounds(scale: str, expected: str) -> None:
    assert expected in problems(FLEET.replace('"10000/3"', scale))


def test_many_mistakes_of_a_long_file_take_no_long_time() -> None:
    """Each was looked for in a copy of all steps: those of 10,000 steps took 38 s."""
    steps = "\n".join("  - {do: mvoe, to: {gantry.x: 1}}" for _ in range(5_000))
    begun_s = time.process_time()
    text = problems(f"schema: tutti.job/1\nname: many\nsteps:\n{steps}\n", Job)
    assert time.process_time() - begun_s < 2.0  # 0.4 s on a quiet machine
    assert "f.yaml:5: steps[1]" in text


def test_a_block_can_be_used_again_by_an_alias() -> None:
    text = FLEET.replace(
        "limits: {velocity: 200, acceleration: 1000}, soft", "limits: &l {velocity: 200, acceleration: 1000}, soft"
    )
    text = text.replace("limits: {velocity: 200, acceleration: 1000}}", "limits: *l}")
    axes = parse_document(text, Fleet, "f").controllers["gantry"].axes
    assert axes["x"].limits == axes["y"].limits


def test_a_wire_that_two_outputs_feed_and_an_output_with_two_purposes() -> None:
    text = FLEET + "wiring: [{from: other.a, to: [other.door]}, {from: other.b, to: [other.door]}]\n"
    text = text.replace("    inputs: {door", "    outputs: {a: {number: 1}, b: {number: 2}}\n    inputs: {door")
    text = text.replace("unit: um", "unit: um, brake: {output: a}")
    assert "wiring[1].to[0]: input other.door is wired to other.a and to other.b" in problems(text)
    assert "output other.a is the brake of other.z and a trigger line; use one output for each" in problems(text)
