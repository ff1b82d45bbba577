"""`tools/mutants.py` lists changes that are Python, each of one place, and tells which tests notice one."""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))
import mutants  # noqa: E402
from mutants import Finding, Mutant, apply_mutant, list_mutants  # noqa: E402

MODULE = '''"""Text: é."""
LIMIT_NS = 500 * 1000


def brake(axis, limit):
    """Brake."""
    if axis.is_moving and limit:
        axis.stop_now("é", limit + 1)
    return "é" + axis.name, axis.speed < limit
'''


def test_each_kind_of_change_is_made_in_its_place() -> None:
    changes = {mutant.kind: apply_mutant(mutant, MODULE) for mutant in list_mutants("module.py", MODULE)}
    assert changes == {
        "constant times ten": MODULE.replace("500 * 1000", "10 * (500 * 1000)"),
        "condition negated": MODULE.replace("axis.is_moving and limit:", "(not (axis.is_moving and limit)):"),
        "call left out": MODULE.replace('axis.stop_now("é", limit + 1)', "pass"),
        "- for +": MODULE.replace("limit + 1", "(limit - 1)"),
        "comparison turned round": MODULE.replace("axis.speed < limit", "(axis.speed >= limit)"),
    }


def test_changes_of_the_safety_core_are_python_and_drawn_alike() -> None:
    drawn_mutants = mutants.draw_mutants(40)
    assert drawn_mutants[:20] == mutants.draw_mutants(20)
    for mutant in drawn_mutants:
        source = (ROOT / mutant.path).read_text(encoding="utf-8")
        assert ast.dump(ast.parse(apply_mutant(mutant, source))) != ast.dump(ast.parse(source)), mutant


def test_the_tests_of_each_area_exist() -> None:
    assert all((ROOT / test).is_file() for tests in mutants.AREAS.values() for test in tests)


def test_a_row_names_the_test_that_noticed_a_change(tmp_path: Path) -> None:
    path = next(iter(mutants.AREAS))
    module = tmp_path / path
    module.parent.mkdir(parents=True)
    module.write_text("LIMIT = 5\n", encoding="utf-8")
    for test in mutants.AREAS[path]:
        test_file = tmp_path / test
        test_file.parent.mkdir(parents=True, exist_ok=True)
        text = f"from pathlib import Path\n\n\ndef test_limit():\n    assert Path({path!r}).read_text() == 'LIMIT = 5\\n'\n"
        test_file.write_text(text, encoding="utf-8")
    mutant = Mutant(path, 1, len("LIMIT = "), "5", "50", "constant times ten")
    finding = mutants.try_mutant(mutant, tmp_path, 0)
    assert finding == Finding(f"{Path(mutants.AREAS[path][0]).name}::test_limit", 0)
    assert f"| {path}:1 | constant times ten: 5 | {finding.test} | 0 of 0 |" == mutants.describe_finding(
        mutant, finding, 0
    )
    assert module.read_text(encoding="utf-8") == "LIMIT = 5\n"
    assert Finding("", 0).is_unnoticed
