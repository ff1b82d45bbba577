"""Templates: values keep their types, every mistake has its place, and a filled job has plain steps."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from orchestrator.model.jobs.files import FileError, read_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.io import SetOutput
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.repeat import Repeat
from orchestrator.model.steps.scan import Scan
from orchestrator.model.templates.file_schema import make_job_file_schema
from orchestrator.model.templates.template import ParameterSetting, Template, load_job, read_settings_file

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "scan.template.job.yaml"

TEXT = """schema: tutti.job/1
name: scan ${label}
parameters:
  width: {type: quantity, unit: mm, default: 10 mm, min: 1 mm, max: 50 mm, description: of a line}
  passes: {type: integer, default: 3, min: 1, max: 20}
  factor: {type: number, default: 1.5, max: 10}
  speed: {type: part, default: 50%}
  label: {type: text, default: a, choices: [a, b, "5"]}
  pulse: {type: duration, default: 10 ms, max: 1 s}
  lamp: {type: boolean, default: true}
steps:
  - {do: move, name: "${passes} of ${factor}, $${x}", to: {gantry.x: "${width}", gantry.y: "-${width}"}, speed: "${speed}"}
  - do: dwell
    duration: ${pulse}
  - {do: output, output: gantry.lamp, value: "${lamp}"}
  - {do: move, by: {gantry.x: "${factor}", gantry.y: "-${factor}", stage.u: "-${passes}"}}
"""


def template(text: str = TEXT) -> Template:
    return Template(read_document(text, "f.yaml"))


def written(**values: str) -> dict[str, ParameterSetting]:
    """Settings as `--set` gives them."""
    return {name: ParameterSetting(value, "--set", written=True) for name, value in values.items()}


def problems(text: str = TEXT, /, **values: Any) -> list[str]:
    with pytest.raises(FileError) as caught:
        template(text).fill(values)
    return str(caught.value).splitlines()


def test_defaults_fill_a_job_of_plain_steps() -> None:
    job = template().fill()
    move, dwell, output, back = job.steps
    assert isinstance(move, Move) and isinstance(dwell, Dwell) and isinstance(output, SetOutput)
    assert job.name == "scan a"
    assert (move.name, move.to, move.speed) == ("3 of 1.5, ${x}", {"gantry.x": "10 mm", "gantry.y": "-10 mm"}, 0.5)
    assert (dwell.duration, output.value) == (10_000_000, True)
    assert isinstance(back, Move) and back.by == {"gantry.x": 1.5, "gantry.y": -1.5, "stage.u": -3}
    assert job.parameters_used == {
        "width": "10 mm",
        "passes": "3",
        "factor": "1.5",
        "speed": "0.5",
        "label": "a",
        "pulse": "10 ms",
        "lamp": "true",
    }
    # What is sent and kept is that job, and needs no template.
    assert Job.model_validate_json(job.to_json()) == job
    assert "parameters" not in job.to_plain()


@pytest.mark.parametrize(
    ("given", "target"),
    [(20, "20 mm"), (2.5, "2.5 mm"), ("20", "20 mm"), ("2 cm", "2 cm"), ("20mm", "20 mm"), ("+7 mm", "+7 mm")],
)
def test_a_number_without_a_unit_is_in_the_unit_of_the_parameter_wherever_it_is_used(given: Any, target: str) -> None:
    move = template().fill(width=given).steps[0]
    assert isinstance(move, Move)
    assert move.to == {"gantry.x": target, "gantry.y": f"-{target.removeprefix('+')}"}


def test_a_minus_before_a_negative_quantity_is_none() -> None:
    text = TEXT.replace("default: 10 mm, min: 1 mm", "default: -10 mm, min: -20 mm")
    move = template(text).fill().steps[0]
    assert isinstance(move, Move)
    assert move.to == {"gantry.x": "-10 mm", "gantry.y": "10 mm"}


def test_the_text_of_a_command_line_is_of_the_type_of_its_parameter() -> None:
    job = template().fill_settings(written(width="2 cm", passes="5", lamp="false", label="5", speed="80%")).job
    assert job.name == "scan 5"
    assert job.parameters_used["width"] == "2 cm" and job.parameters_used["passes"] == "5"
    assert isinstance(job.steps[2], SetOutput) and job.steps[2].value is False


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"width": "25 deg"}, "width: deg is a unit of angle, and the parameter is in mm; use one of: m, cm, mm"),
        ({"width": 60}, "width: found 60; must be at most 50 mm"),
        ({"width": "600 um"}, "width: found '600 um'; must be at least 1 mm"),
        ({"width": "wide"}, "width: 'wide' is not a quantity"),
        ({"width": True}, "width: write a number in the axis's unit"),
        ({"width": float("nan")}, "width: nan is out of range"),
        ({"passes": 2.5}, "passes: found 2.5; must be a whole number"),
        ({"passes": "3"}, "passes: found '3'; must be a whole number; write it without quotes: 3"),
        ({"passes": True}, "passes: found true; must be a whole number"),
        ({"passes": 21}, "passes: found 21; must be at most 20"),
        ({"factor": float("inf")}, "factor: found inf; the largest number is"),
        ({"speed": "150%"}, "speed: found '150%'; must be above 0 and at most 1 (100%)"),
        ({"speed": 0}, "speed: found 0; must be above 0"),
        ({"label": 5}, 'label: found 5; must be text; write it in quotes: "5"'),
        ({"label": "c"}, "label: found 'c'; allowed: a, b, 5"),
        ({"pulse": 10}, "pulse: 10 is not a duration; write a number and a unit"),
        ({"pulse": "2 s"}, "pulse: found '2 s'; must be at most 1 s"),
        ({"lamp": "yes"}, "lamp: found 'yes'; write true"),
        ({"lamp": 1}, "lamp: found 1; must be true or false"),
        ({"widht": 1}, "widht: the job file has no parameter widht; did you mean width? its parameters are: width, p"),
    ],
)
def test_bad_values(values: dict[str, Any], expected: str) -> None:
    (line,) = problems(**values)
    assert line.startswith(f"parameters: {expected}")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("default: 3, min: 1", "default: 0, min: 1", "f.yaml:5: parameters.passes.default: the default is not allowed"),
        ("min: 1 mm, max: 50 mm", "min: 5 cm, max: 1 mm", "f.yaml:4: parameters.width.min: min is above max; swap them"),
        ("min: 1 mm", "min: 1 s", "f.yaml:4: parameters.width.min: unknown unit 's'"),
        ("default: 10 mm", "default: 1 deg", "f.yaml:4: parameters.width.default: the default is not allowed: deg is a"),
        ("unit: mm, ", "", "f.yaml:4: parameters.width.unit: is missing"),
        ("type: number", "type: float", "f.yaml:6: parameters.factor: found 'float' for 'type'; allowed: 'quantity'"),
        ("type: number, ", "", "f.yaml:6: parameters.factor: needs the field 'type'"),
        ("max: 20}", "maximum: 20}", "f.yaml:5: parameters.passes.maximum: unknown field; did you mean max? allowed: "),
        ("default: a, choices", "default: c, choices", "f.yaml:8: parameters.label.default: the default is not allowed"),
        ("[a, b, ", "[a, a, ", "f.yaml:8: parameters.label.choices: a is listed twice"),
        ("default: 10 ms", "default: 10", "f.yaml:9: parameters.pulse.default: 10 is not a duration"),
        ("  lamp: {", "  Lamp-1: {", "f.yaml:10: parameters.Lamp-1: 'Lamp-1' is no name of a parameter; write a-z"),
        ("  lamp: {type: boolean, default: true}", "  lamp: true", "f.yaml:10: parameters.lamp: found true"),
        ('"${width}", gantry.y', '"${wdth}", gantry.y', "f.yaml:12: steps[0].to.gantry.x: the job file has no parameter "),
        ("${pulse}", "${ pulse }", "f.yaml:14: steps[1].duration: ${ pulse } is no reference; write ${name}"),
        ("${pulse}", "${pulse", "f.yaml:14: steps[1].duration: ${pulse is no reference"),
        ("${pulse}", "-${pulse}", "f.yaml:14: steps[1].duration: found '-${pulse}'; only a quantity, a number or an"),
        ("{gantry.x: \"${width}\",", "{\"${label}.x\": 1,", "steps[0].to.${label}.x: a parameter stands for a value, not"),
        ("schema: tutti.job/1\n", "schema: tutti.job/1\nparameters_used: {}\n", "parameters_used: is written when a temp"),
    ],
)  # fmt: skip
def test_mistakes_of_the_file(old: str, new: str, expected: str) -> None:
    assert old in TEXT
    lines = problems(TEXT.replace(old, new, 1))
    assert any(expected in line for line in lines), lines


def test_a_mistake_of_the_job_is_at_the_line_where_the_value_is_used_and_names_the_parameter() -> None:
    text = TEXT.replace("${pulse}", "${width}").replace("name: scan ${label}", "name: ''")
    assert problems(text) == [
        "f.yaml:2: name: found ''; at least 1 must be given",
        "f.yaml:14: steps[1].duration: '10 mm' is not a duration; write a number and a unit (ns, us, ms, s, min, h), "
        'e.g. "10 ms" (${width} is 10 mm)',
    ]


def test_all_mistakes_are_reported_at_once_and_what_a_wrong_value_causes_is_not() -> None:
    text = TEXT.replace("max: 20}", "max: 0}").replace("do: dwell", "do: wait\n    input: gantry.door")
    assert [line.partition(" ")[0] for line in problems(text, width="1 deg", lamp="no", colour="red")] == [
        "parameters:",
        "parameters:",
        "parameters:",
        "f.yaml:5:",
        "f.yaml:13:",
        "f.yaml:15:",
    ]


def test_a_parameter_without_a_default_must_have_a_value() -> None:
    text = TEXT.replace("default: 10 ms, ", "")
    assert problems(text) == ["f.yaml:9: parameters.pulse: has no default; give it a value: `--set pulse=…`"]
    assert template(text).fill(pulse="3 ms").parameters_used["pulse"] == "3 ms"


def test_a_job_file_without_parameters_is_a_job_as_before_and_refers_to_none() -> None:
    text = "schema: tutti.job/1\nname: j\nsteps:\n  - {do: dwell, duration: 1 s}\n"
    assert template(text).fill().parameters_used == {}
    assert "it declares none" in problems(text.replace("1 s", '"${x}"'))[0]
    assert "it declares none" in problems(text, x=1)[0]


def test_inside_braces_a_missing_pair_of_quotes_is_named() -> None:
    with pytest.raises(FileError, match=r"f:1: not YAML: .*; inside braces and brackets write a parameter in quotes"):
        read_document("a: {b: ${width}}", "f")


def test_what_is_declared_and_not_used_is_listed() -> None:
    text = TEXT.replace("${pulse}", "1 ms")
    assert [str(each) for each in template(text).list_unused()] == [
        "f.yaml:9: parameters.pulse: is declared and not used; write ${pulse}, or remove it"
    ]


def test_values_of_a_file_have_its_lines(tmp_path: Path) -> None:
    path = tmp_path / "values.yaml"
    path.write_text("width: 20 mm\npasses: 5.5\n", encoding="utf-8")
    with pytest.raises(FileError, match=rf"{re.escape(str(path))}:2: passes: found 5.5; must be a whole number"):
        template().fill_settings(read_settings_file(path))
    path.write_text("- 1\n", encoding="utf-8")
    with pytest.raises(FileError, match=":1: must be a mapping"):
        read_settings_file(path)


def test_the_example_is_filled_by_name() -> None:
    example = Template.load(EXAMPLE)
    assert example.parameters["width"].description == "length of a line"
    assert load_job(EXAMPLE, {"width": 30}).steps == example.fill(width="30 mm").steps
    assert [words for words, _ in example.list_extremes({})][:2] == ["width=1 mm (its min)", "width=100 mm (its max)"]


SCANS = """schema: tutti.job/1
name: x
parameters:
  times: {type: integer, default: 3}
  points: {type: integer, default: 5, min: 2}
  width: {type: quantity, unit: mm, default: 20 mm}
  start: {type: text, default: sample}
  snake: {type: boolean, default: true}
  pulse: {type: duration, default: 10 ms}
steps:
  - do: repeat
    times: ${times}
    steps:
      - do: scan
        axes:
          gantry.x: {from: "${start}", to: "-${width}", points: "${points}", snake: "${snake}"}
          stage.u: {values: [0, "${width}"]}
        at_each:
          - {do: output, output: gantry.lamp, value: true, pulse: "${pulse}"}
  - {do: scan, points: {file: "${start}.csv"}}
"""


def test_parameters_stand_in_scans_and_repeats(tmp_path: Path) -> None:
    path = tmp_path / "x.job.yaml"
    path.write_text(SCANS, encoding="utf-8")
    repeat, table = Template.load(path).fill(points=7, pulse="2 ms").steps
    assert isinstance(repeat, Repeat) and repeat.times == 3 and isinstance(repeat.steps[0], Scan)
    x, u = repeat.steps[0].axes.values()
    assert (x.from_, x.to, x.points, x.snake, u.values) == ("sample", "-20 mm", 7, True, [0, "20 mm"])
    assert repeat.steps[0].at_each == [SetOutput(output="gantry.lamp", value=True, pulse="2 ms")]
    # A path in a template is one beside it, like one in a job.
    assert isinstance(table, Scan) and table.points is not None and table.points.file == str(tmp_path / "sample.csv")
    assert problems(SCANS, points=1) == ["parameters: points: found 1; must be at least 2"]
    assert problems(SCANS, times=0) == ["f.yaml:12: steps[0].times: found 0; must be at least 1 (${times} is 0)"]


def test_the_schema_for_editors_accepts_references_where_values_stand() -> None:
    schema = make_job_file_schema()
    steps = schema["$defs"]

    def takes(field: dict[str, Any], text: str) -> bool:
        if "anyOf" in field:
            return any(takes(each, text) for each in field["anyOf"])
        plain = field.get("type") == "string" and not field.keys() & {"enum", "const"}
        return plain and bool(re.search(field.get("pattern", ""), text))

    for step, name in (
        ("Move", "speed"), ("Move", "sync"), ("Move", "align"), ("Move", "max_start_skew"), ("Dwell", "duration"),
        ("SetOutput", "value"), ("SetOutput", "output"), ("WaitInput", "timeout"), ("SetOutput", "pulse"),
        ("ScanAxis", "from"), ("ScanAxis", "points"), ("ScanAxis", "snake"), ("Repeat", "times"), ("PointTable", "file"),
    ):  # fmt: skip
        assert takes(steps[step]["properties"][name], "${width}"), (step, name)
    assert takes(steps["Dwell"]["properties"]["duration"], "${count} ms")
    assert not takes(steps["Dwell"]["properties"]["duration"], "often")
    assert not takes(steps["Dwell"]["properties"]["do"], "${width}")
    assert takes(steps["Enable"]["properties"]["axes"]["items"], "${axis}")
    assert takes(steps["PointTable"]["properties"]["rows"]["anyOf"][0]["items"]["items"], "${there}")
    assert schema["properties"]["parameters"]["additionalProperties"]["discriminator"]["propertyName"] == "type"
    assert {each["$ref"].rpartition("/")[2] for each in schema["properties"]["parameters"]["additionalProperties"]["oneOf"]} <= steps.keys()  # fmt: skip
    json.dumps(schema)


# Buttons

BUTTON = "schema: tutti.job/1\nname: park\nbutton: {}\nsteps:\n  - {{do: dwell, duration: 1 s}}\n"


def test_a_button_is_of_the_file_and_not_of_its_job() -> None:
    park = template(BUTTON.format("{label: ' Park ', group: Ends}"))
    assert park.button is not None and (park.button.label, park.button.group) == ("Park", "Ends")
    assert "button" not in park.fill().to_plain()
    alone = template(BUTTON.format("{label: Park}")).button
    assert alone is not None and alone.group is None
    assert template(BUTTON.format("null")).button is None
    assert template().button is None


@pytest.mark.parametrize(
    ("button", "problem"),
    [
        ("{label: ''}", "f.yaml:3: button.label: must have a character that is seen, for example `Park`"),
        ("{label: '  '}", "f.yaml:3: button.label: must have a character that is seen, for example `Park`"),
        ("{label: a, group: ''}", "f.yaml:3: button.group: must have a character that is seen, for example `Park`"),
        (f"{{label: {'x' * 41}}}", "f.yaml:3: button.label: has 41 entries or characters; at most 40"),
        (f"{{label: a, group: {'x' * 41}}}", "f.yaml:3: button.group: has 41 entries or characters; at most 40"),
        ('{label: "a\\tb"}', "f.yaml:3: button.label: has the character U+0009, which cannot be seen; remove it"),
        ('{label: "a\\u202eb"}', "f.yaml:3: button.label: has the character U+202E, which cannot be seen; remove it"),
        ('{label: "to ${width}"}', "f.yaml:3: button.label: has a parameter, and a button is shown before parameters"),
        ("{group: Ends}", "f.yaml:3: button.label: is missing"),
        ("{label: 5}", 'f.yaml:3: button.label: found 5; must be text; write it in quotes: "5"'),
        ("{label: a, colour: red}", "f.yaml:3: button.colour: unknown field"),
        ("Park", "f.yaml:3: button: found 'Park'; must be a mapping"),
    ],
)
def test_a_wrong_button_is_a_mistake_of_the_file(button: str, problem: str) -> None:
    (found_problem,) = problems(BUTTON.format(button))
    assert found_problem.startswith(problem)


def test_the_schema_for_editors_has_the_button_without_references() -> None:
    schema = make_job_file_schema()
    assert {"$ref": "#/$defs/JobButton"} in schema["properties"]["button"]["anyOf"]
    assert schema["$defs"]["JobButton"]["properties"]["label"]["maxLength"] == 40
