"""Short forms in fleet files: entries for many, variables, fragments; their mistakes by file, line and member."""

import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from orchestrator.cli.main import main
from orchestrator.gateway.fleet_files import compare_fleet
from orchestrator.model.expansion import expander, fragments
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, load_fleet, parse_document, read_document
from orchestrator.model.templates.fleet_schema import make_fleet_file_schema, make_fragment_schema
from orchestrator.runtime.checked import load_checked_fleet

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
AXES = "axes: {x: {motors: [X], unit: mm, limits: {velocity: 200, acceleration: 1000}}}"
HEAD = "schema: tutti.fleet/1\nfleet: hall\n"
CONTROLLER = "adapter: smc4000, link: {kind: tcp, host: 10.0.0.1, port: 23}, " + AXES
HALL = f"""{HEAD}controllers:
  stage-{{n}}:
    count: 250
    adapter: smc4000
    link: {{kind: tcp, host: "10.0.1.{{n}}", port: "{{n+8000}}"}}
    {AXES}
groups:
  stages: [{{count: 250, item: "stage-{{n}}.x"}}]
"""


def load(text: str) -> Fleet:
    return parse_document(text, Fleet, "f.yaml")


def problems(text: str) -> list[str]:
    with pytest.raises(FileError) as caught:
        load(text)
    return str(caught.value).splitlines()


def write(folder: Path, **files: str) -> Path:
    """Write fragments and a fleet file `main`; return the path of that one."""
    for name, text in files.items():
        head = HEAD if name == "main" else "schema: tutti.fragment/1\n"
        (folder / f"{name}.yaml").write_text(head + text, encoding="utf-8")
    return folder / "main.yaml"


def file_problems(path: Path) -> list[str]:
    with pytest.raises(FileError) as caught:
        load_fleet(path)
    return [line.replace(f"{path.parent}/", "") for line in str(caught.value).splitlines()]


def plain(text: str, section: str) -> Any:
    """A section of a fleet file as it is expanded, not validated."""
    return read_document(HEAD + text, "f.yaml").root.value[section]


# Entries for many


def test_a_short_form_is_the_same_fleet_as_the_long_one() -> None:
    controllers = {f"stage-{n}": {"adapter": "smc4000", "link": {"kind": "tcp", "host": f"10.0.1.{n}", "port": n + 8000},
                                  "axes": {"x": {"motors": ["X"], "unit": "mm", "limits": {"velocity": 200, "acceleration": 1000}}}}
                   for n in range(1, 251)}  # fmt: skip
    groups = {"stages": [f"stage-{n}.x" for n in range(1, 251)]}
    long_fleet = Fleet.model_validate(
        {"schema": "tutti.fleet/1", "fleet": "hall", "controllers": controllers, "groups": groups}
    )
    short_fleet = load(HALL)
    assert short_fleet == long_fleet and short_fleet.digest == long_fleet.digest
    # What is saved and sent is the expanded fleet, and reads as the same.
    assert parse_document(short_fleet.to_json().decode(), Fleet, "saved") == long_fleet


@pytest.mark.parametrize(
    ("each", "names"),
    [
        ("count: 3", ["1", "2", "3"]),
        ("each: {n: 7..9}", ["7", "8", "9"]),
        ("each: {n: [left, 5, 0.50]}", ["left", "5", "0.50"]),
        ("each: [{n: b}, {n: a}]", ["b", "a"]),
    ],
)
def test_the_values_of_variables(each: str, names: list[str]) -> None:
    assert plain(f"groups:\n  g-{{n}}: {{{each}, item: [a.x]}}\n", "groups") == {f"g-{name}": ["a.x"] for name in names}


def test_several_variables_are_combined_the_last_one_changes_first() -> None:
    text = 'groups:\n  g: [{each: {row: 1..2, n: [5, 6]}, item: "s-{row}-{n}.x"}]\n'
    assert plain(text, "groups") == {"g": ["s-1-5.x", "s-1-6.x", "s-2-5.x", "s-2-6.x"]}


def test_a_variable_alone_keeps_its_type_and_braces_are_doubled() -> None:
    entry = '{each: [{n: 3, v: 0.50, w: true, t: "07"}], item: ["{n}", "{n-1}", "{v}", "{w}", "{t}", "a{v}{n+10}", "{{n}}", "{ n }"]}'
    assert plain(f"groups:\n  g: {entry}\n", "groups")["g"] == [3, 2, 0.5, True, "07", "a0.5013", "{n}", "{ n }"]


def test_entries_within_entries_have_the_variables_of_both() -> None:
    text = 'groups:\n  r-{row}:\n    each: {row: 1..2}\n    item: [{count: 2, item: "{row}.{n}"}]\n'
    assert plain(text, "groups") == {"r-1": ["1.1", "1.2"], "r-2": ["2.1", "2.2"]}
    text = 'home_order: [{each: {row: 1..2}, item: {count: 2, item: "{row}.{n}"}}]\n'
    assert plain(text, "home_order") == ["1.1", "1.2", "2.1", "2.2"]


def test_outside_short_forms_and_in_sections_of_users_all_is_literal() -> None:
    assert plain('groups: {a: ["{n}"], "b-{n}": [x]}\n', "groups") == {"a": ["{n}"], "b-{n}": ["x"]}
    assert plain("controllers: {a: {options: {o: {count: 2}}}}\n", "controllers") == {
        "a": {"options": {"o": {"count": 2}}}
    }
    assert plain("integrations: {mqtt: {count: 2}}\n", "integrations") == {"mqtt": {"count": 2}}
    short = 'controllers: {"a{n}": {count: 1, options: {o: {each: "{n}"}}}}\n'
    assert plain(short, "controllers") == {"a1": {"options": {"o": {"each": 1}}}}


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("count: 0", "groups.g.count: makes 0 members; 1 to 5000 are allowed"),
        ("count: 5001", "groups.g.count: makes 5001 members; 1 to 5000 are allowed"),
        ("count: many", "groups.g.count: found 'many'; must be a whole number"),
        ("count: true", "groups.g.count: found true; must be a whole number"),
        ("count: 2, each: {n: 1..2}", "groups.g.count: `count: 5` is `each: {n: 1..5}`; leave one of the two out"),
        ("each: {a: 1..100, b: 1..100}", "groups.g.each: makes 10000 members"),
        ("each: {a: 1..999999999}", "groups.g.each: makes 999999999 members"),
        ("each: {a: 5..1}", "groups.g.each: makes -3 members"),
        ("each: {a: 5}", "groups.g.each: a: found 5; write e.g. `each: {row: 1..5, n: 1..50}`"),
        ("each: {a: []}", "groups.g.each: a: found []; write e.g."),
        ("each: {a: [[1]]}", "groups.g.each: a: found [[1]]; write e.g."),
        ("each: []", "groups.g.each: makes 0 members"),
        ("each: 5", "groups.g.each: found 5; write e.g."),
        ("each: {A: 1..2}", "groups.g.each: 'A' is no name of a variable"),
        ("each: [{a: 1}, {b: 1}]", "groups.g.each: each entry must have the same variables"),
        ("each: [{a: {b: 1}}]", 'groups.g.each: a: found {"b": 1}; must be one number or text'),
    ],
)
def test_wrong_numbers_of_members(entry: str, expected: str) -> None:
    (line,) = problems(f"{HEAD}controllers: {{a: {{{CONTROLLER}}}}}\ngroups:\n  g: {{{entry}, item: []}}\n")
    assert line.startswith(f"f.yaml:5: {expected}")


def test_all_that_cannot_be_expanded_is_listed_at_once() -> None:
    text = f"{HEAD}controllers:\n  a-{{n}}:\n    count: 0\n    {AXES}\n  b-{{m}}: {{each: {{m: 1..2}}, link: '{{q}}'}}\ngroups: {{g: [{{count: 9999, item: x}}]}}\n"
    assert [line.partition("; ")[0] for line in problems(text)] == [
        "f.yaml:5: controllers.a-{n}.count: makes 0 members",
        "f.yaml:7: controllers.b-1.link: there is no variable q",
        "f.yaml:8: groups.g[0].count: makes 9999 members",
    ]


# Mistakes of members


def test_a_mistake_of_all_members_is_said_once_with_their_number() -> None:
    lines = problems(HALL.replace("unit: mm", "unit: furlong"))
    assert len(lines) == 1
    assert lines[0].startswith("f.yaml:8: controllers.stage-1.axes.x.unit: found 'furlong'; allowed: 'm'")
    assert lines[0].endswith("(the same in 249 more of controllers.stage-{n}.axes.x.unit)")


def test_a_mistake_of_one_member_names_it() -> None:
    text = (
        HALL.replace('port: "{n+8000}"', 'port: "{n+65290}"')
        .replace("count: 250\n", "count: 246\n")
        .replace("item: ", "item: ")
        .replace("count: 250", "count: 246")
    )
    assert problems(text) == ["f.yaml:7: controllers.stage-246.link.port: found 65536; must be at most 65535"]
    (line,) = problems(HALL.replace("[{count: 250", "[{count: 251"))
    assert line.startswith("f.yaml:10: groups.stages[250]: the fleet has no axis stage-251.x")


def test_a_thousand_entries_with_ten_mistakes_each_in_ten_lines() -> None:
    text = f"""{HEAD.replace("hall", "Hall")}controllers:
  stage-{{row}}-{{n}}:
    each: {{row: 1..5, n: 1..200}}
    adapter: 5
    host: lab-{{rwo}}
    colour: red
    link:
      kind: tcp
      host: "10.0.{{row}}.{{n}}"
      port: 99999
      speed: 5
    axes:
      x:
        motors: [X]
        unit: furlong
        limits: {{velocity: -1, acceleration: 1000}}
        sign: 2
groups:
  hall: [stage-9-1.x]
"""
    lines = problems(text)
    found = {(int(line.split(":")[1]), line.split(": ")[1]) for line in lines}
    assert len(lines) == 10 and found == {
        (2, "fleet"), (6, "controllers.stage-1-1.adapter"), (7, "controllers.stage-1-1.host"), (8, "controllers.stage-1-1.colour"),
        (12, "controllers.stage-1-1.link.port"), (13, "controllers.stage-1-1.link.speed"), (17, "controllers.stage-1-1.axes.x.unit"),
        (18, "controllers.stage-1-1.axes.x.limits.velocity"), (19, "controllers.stage-1-1.axes.x.sign"), (21, "groups.hall[0]"),
    }  # fmt: skip
    assert sum("(the same in 999 more of controllers.stage-{row}-{n}" in line for line in lines) == 8


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("stage-{n}:", "stage:", "f.yaml:4: controllers.stage: is there twice, from line 4 and line 4; give each its own name"),
        ("stage-{n}:", "stage-{k}:", "f.yaml:4: controllers.stage-{k}: there is no variable k; variables: n (a brace is written twice: {{)"),
        ("{n+8000}", "{m}", "f.yaml:7: controllers.stage-1.link.port: there is no variable m; variables: n"),
        ("    count: 250\n", "    each: {n: [a]}\n", "f.yaml:7: controllers.stage-a.link.port: {n+8000}: only a whole number can be added to, and n is 'a'"),
        ('port: "{n+8000}"', "port: {n}", 'f.yaml:7: controllers.stage-1.link.port: write a variable that stands alone in quotes: "{n}"'),
        ('"10.0.1.{n}"', "10.0.1.{n}", "f.yaml:7: not YAML: "),
    ],
)  # fmt: skip
def test_wrong_variables_and_names(old: str, new: str, expected: str) -> None:
    lines = problems(HALL.replace(old, new, 1).partition("groups:")[0])
    assert len(lines) == 1 and lines[0].startswith(expected)


def test_yaml_without_the_quotes_that_braces_need_says_so() -> None:
    (line,) = problems(HALL.replace('"10.0.1.{n}"', "10.0.1.{n}"))
    assert line.endswith("inside braces and brackets write a value with {n} in quotes")


def test_item_stands_alone() -> None:
    (line, *_) = problems(
        f"{HEAD}controllers: {{a: {{{CONTROLLER}}}}}\ngroups: {{g: {{count: 1, item: [a.x], other: 1}}}}\n"
    )
    assert line.startswith("f.yaml:4: groups.g: beside `item` nothing but `count` or `each` has a meaning")


def test_what_is_expanded_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    (line,) = problems(f"{HEAD}home_order: [{{count: 5000, item: a}}, {{count: 5000, item: b}}, c]\n")
    assert line == "f.yaml:3: home_order: has more than 10000 entries when it is expanded"
    monkeypatch.setattr(expander, "MAX_EXPANDED", 5_000)
    inner = "{each: {a: 1..500}, item: {each: {b: 1..500}, item: '{a}-{b}'}}"
    (line,) = problems(f"{HEAD}home_order: [{inner}]\n")
    assert line.endswith("makes more than 5000 values when it is expanded")


# Fragments

PAIR = f"""defaults: {{port: 23}}
controllers:
  "{{name}}-{{side}}":
    each: {{side: [left, right]}}
    adapter: smc4000
    link: {{kind: tcp, host: "{{name}}-{{side}}", port: "{{port}}"}}
    {AXES}
groups: {{"{{name}}": ["{{name}}-left.x", "{{name}}-right.x"]}}
home_order: ["{{name}}"]
"""


def test_one_fragment_serves_many_machines(tmp_path: Path) -> None:
    include = 'include:\n  - {file: pair.yaml, each: {n: 1..2}, with: {name: "p{n}"}}\n  - {file: pair.yaml, with: {name: q, port: 99}}\n'
    fleet = load_fleet(
        write(tmp_path, pair=PAIR, main=f"controllers: {{a: {{{CONTROLLER}}}}}\nhome_order: [a]\n{include}")
    )
    assert list(fleet.controllers) == ["a", "p1-left", "p1-right", "p2-left", "p2-right", "q-left", "q-right"]
    assert [getattr(fleet.controllers[name].link, "port", None) for name in ("p1-left", "q-left")] == [23, 99]
    assert fleet.home_order == ["a", "p1", "p2", "q"] and fleet.groups["q"] == ["q-left.x", "q-right.x"]


def test_a_fleet_may_be_of_fragments_alone_in_folders_and_in_each_other(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "table.csv").write_text("position mm, error um\n0, 0\n10, 3\n", encoding="utf-8")
    table = AXES.replace("unit: mm", "unit: mm, soft_limits: {min: 0, max: 10}, correction: {file: table.csv}")
    write(
        tmp_path / "parts",
        pair=PAIR.replace(AXES, table),
        both='include: {file: pair.yaml, with: {name: "{hall}-p"}}\n',
    )
    main = write(tmp_path, main="include: [{file: parts/both.yaml, with: {hall: h}}]\n")
    fleet = load_fleet(main)
    assert list(fleet.controllers) == ["h-p-left", "h-p-right"]
    # A table of a fragment is beside the fragment.
    assert fleet.controllers["h-p-left"].axes["x"].correction is not None
    assert parse_document(fleet.to_json().decode(), Fleet, "saved") == fleet


def test_zones_of_a_fragment_are_added_by_body_and_rule(tmp_path: Path) -> None:
    fragment = 'zones:\n  bodies: {"{b}": {count: 1}}\n  homes_away: ["{b}.x"]\n  step_skew: 1\n'
    main = write(
        tmp_path,
        part=fragment,
        main="zones: {bodies: {a: {}}, homes_away: [a.x], step_skew: 1}\ninclude: {file: part.yaml, with: {b: b}}\ncontrollers: {}\n",
    )
    assert "main.yaml:3: zones.step_skew: stands in part.yaml too, line 5; leave one of the two out" in [
        line.replace(f"{tmp_path}/", "") for line in file_problems(main)
    ]


def test_a_mistake_in_a_fragment_names_its_file_line_and_member(tmp_path: Path) -> None:
    include = 'include: {file: pair.yaml, each: {n: 1..20}, with: {name: "p{n}"}}\n'
    lines = file_problems(write(tmp_path, pair=PAIR.replace("unit: mm", "unit: furlong"), main=include))
    assert len(lines) == 1 and lines[0].startswith("pair.yaml:8: controllers.p1-left.axes.x.unit: found 'furlong'")
    assert lines[0].endswith("(the same in 39 more of controllers.{name}-{side}.axes.x.unit)")


def test_names_that_are_there_twice_name_both_places(tmp_path: Path) -> None:
    include = "include: [{file: pair.yaml, with: {name: a}}]\n"
    lines = file_problems(write(tmp_path, pair=PAIR, main=f"controllers:\n  a-left: {{{CONTROLLER}}}\n{include}"))
    assert lines == [
        "main.yaml:4: controllers.a-left: is there twice, from line 4 and pair.yaml 4; give each its own name, with all variables that change in it"
    ]


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"main": "include: [main.yaml]\n"}, "main.yaml:3: include[0]: includes itself: main.yaml includes main.yaml"),
        (
            {"main": "include: a.yaml\n", "a": "include: b.yaml\n", "b": "include: ./a.yaml\n"},
            "b.yaml:2: include: includes itself: main.yaml includes a.yaml includes b.yaml includes a.yaml",
        ),
        ({"main": "include: c.yaml\n"}, "main.yaml:3: include: c.yaml cannot be read: No such file or directory; it is looked for beside its own file"),
        ({"main": "include: a.yaml\n", "a": "groups: {a: [b, c\n"}, "a.yaml:3: not YAML: "),
        ({"main": "include: a.yaml\n", "a": "fleet: b\n"}, "a.yaml:2: fleet: a fragment may have: controllers, wiring, permits"),
        ({"main": "include: {file: a.yaml, with: {b: 1}}\n", "a": ""}, "main.yaml:3: include: a.yaml has no variable b; its variables: none"),
        ({"main": "include: {file: a.yaml, wiht: {b: 1}}\n", "a": ""}, "main.yaml:3: include: found "),
        ({"main": "include: {file: a.yaml, with: 5}\n", "a": ""}, "main.yaml:3: include.with: found 5; must be a mapping of variables"),
        ({"main": "include: {file: a.yaml, with: {b: [1]}}\n", "a": ""}, "main.yaml:3: include.with.b: found [1]; a variable has a name"),
        ({"main": "include: 5\n"}, "main.yaml:3: include: found 5; write a file, or {file: pair.fragment.yaml"),
        ({"main": "include: [{count: 0, file: a.yaml}]\n", "a": ""}, "main.yaml:3: include[0].count: makes 0 members"),
        ({"main": "include: a.yaml\n", "a": "defaults: 5\n"}, "a.yaml:2: defaults: found 5; must be a mapping"),
        ({"main": "include: a.yaml\n", "a": 'groups: {"{b}": []}\n'}, "a.yaml:2: groups.{b}: there is no variable b; variables: none"),
    ],
)  # fmt: skip
def test_wrong_inclusions(tmp_path: Path, files: dict[str, str], expected: str) -> None:
    controllers = "" if "{b}" not in str(files) else f"controllers: {{a: {{{CONTROLLER}}}}}\n"
    lines = file_problems(write(tmp_path, **{**files, "main": files["main"] + controllers}))
    assert len(lines) == 1 and lines[0].startswith(expected)


def test_a_fleet_file_is_no_fragment_and_a_fragment_no_fleet_file(tmp_path: Path) -> None:
    write(tmp_path, main=f"controllers: {{a: {{{CONTROLLER}}}}}\n", part="")
    (tmp_path / "other.yaml").write_text(f"{HEAD}include: main.yaml\n", encoding="utf-8")
    assert file_problems(tmp_path / "other.yaml") == [
        "main.yaml:1: schema: a fragment is a mapping that starts with `schema: tutti.fragment/1`"
    ]
    assert file_problems(tmp_path / "part.yaml") == [
        "part.yaml:1: schema: this is a fragment file; a fleet file is needed here: `schema: tutti.fleet/1`"
    ]


def test_fragments_that_include_each_other_without_end_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = {f"f{number}": f"include: f{number + 1}.yaml\n" for number in range(12)}
    (line,) = file_problems(write(tmp_path, main="include: f0.yaml\n", **chain))
    assert "f7.yaml:2: include: more than 8 fragments include each other" in line
    monkeypatch.setattr(fragments, "MAX_INCLUDES", 50)
    wide = {f"w{number}": f"include: [{{file: w{number + 1}.yaml, count: 20}}]\n" for number in range(4)}
    (line,) = {
        line.partition(": ")[2] for line in file_problems(write(tmp_path, main="include: w0.yaml\n", w4="", **wide))
    }
    assert line.endswith("more than 50 fragments are included")


# Other readers


def test_the_page_expands_a_text_and_refuses_one_that_needs_other_files() -> None:
    running = load_fleet(EXAMPLES / "demo.fleet.yaml")
    checked = compare_fleet(HALL, running)
    assert checked["problems"] == [] and len(checked["configuration"]["controllers"]) == 250
    (problem,) = compare_fleet(f"{HALL}include: pair.yaml\n", running)["problems"]
    assert (
        problem["line"] == 11
        and problem["place"] == "include"
        and "as the command `fleet expand` prints it" in problem["text"]
    )


def test_the_example_passes_the_check_of_its_makes() -> None:
    fleet = load_checked_fleet(EXAMPLES / "hall.fleet.yaml")
    assert list(fleet.controllers)[-4:] == ["load-east-left", "load-east-right", "load-west-left", "load-west-right"]
    assert fleet.groups["row-2"] == ["stage-2-1.x", "stage-2-2.x", "stage-2-3.x", "stage-2-4.x"]
    assert fleet.controllers["stage-1-3"].simulate.drift_ppm == 13


# For editors


def test_the_schemas_accept_short_forms_where_entries_stand() -> None:
    schema, fragment = make_fleet_file_schema(), make_fragment_schema()
    models = schema["$defs"]
    (controllers,) = schema["properties"]["controllers"]["patternProperties"].items()
    assert re.search(controllers[0], "stage-{n+1}") and not re.search(controllers[0], "Stage")
    assert {"count", "each", "adapter"} <= models["Controller"]["properties"].keys()
    assert {"$ref": "#/$defs/ShortItem"} in schema["properties"]["home_order"]["items"]["anyOf"]
    port = models["TcpLink"]["properties"]["port"]["anyOf"]
    assert any(re.search(option.get("pattern", "$^"), "{n}") for option in port)
    assert "controllers" not in schema["required"] and "include" in schema["properties"]
    assert fragment["properties"]["schema"]["const"] == "tutti.fragment/1" and "queue" not in fragment["properties"]


def test_the_whole_fleet_is_printed() -> None:
    shown = CliRunner().invoke(main, ["fleet", "expand", str(EXAMPLES / "hall.fleet.yaml")])
    assert parse_document(shown.output, Fleet, "shown") == load_checked_fleet(EXAMPLES / "hall.fleet.yaml")
