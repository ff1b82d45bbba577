"""`tutti fleet check` of virtual axes by code of an installed package."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from orchestrator.cli.main import main
from orchestrator.model.jobs.files import load_fleet

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
CODE = """
import math
import time

class Arm:
    api_version = 1
    of = ("mm",)
    axes = {"angle": "deg"}

    def __init__(self, parameters):
        self.length = parameters["length"]

    def to_virtual(self, real):
        return [math.degrees(math.atan(real[0] / self.length))]

    def to_real(self, virtual):
        return [math.tan(math.radians(virtual[0])) * self.length]

class Slow(Arm):
    def to_real(self, virtual):
        time.sleep(0.1)
        return super().to_real(virtual)

class Raising(Arm):
    def to_virtual(self, real):
        return [1 / 0]

class Constant(Arm):
    def to_real(self, virtual):
        return [3.0]
"""


@pytest.fixture
def check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], tuple[int, str]]:
    """Check the example fleet with virtual axes by a class of an installed package, and these parameters."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "acme_arms.py").write_text(CODE)
    metadata = tmp_path / "acme_arms-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: acme_arms\nVersion: 1.0\n")

    def run(name: str, parameters: str) -> tuple[int, str]:
        (metadata / "entry_points.txt").write_text(f"[tutti.kinematics]\narm = acme_arms:{name}\n")
        importlib.invalidate_caches()
        monkeypatch.delitem(sys.modules, "acme_arms", raising=False)
        group = (
            "  arm: {kind: code, kinematics: arm, of: [front.upper], axes: {angle: {unit: mrad}}"
            f", parameters: {parameters}}}\n"
        )
        text = (EXAMPLES / "table.fleet.yaml").read_text()
        file = tmp_path / "arm.fleet.yaml"
        file.write_text(text.replace("virtual:\n", "virtual:\n" + group))
        result = CliRunner().invoke(main, ["fleet", "check", str(file)], env={"COLUMNS": "250"})
        if result.exit_code == 0:
            (angle,) = load_fleet(file).virtual_axes.maps["arm"].observe([10.0])
            assert angle == pytest.approx(99.669, abs=1e-3)
        return result.exit_code, result.output

    return run


def test_an_installed_class_is_used_in_the_units_of_the_file(check: Callable[[str, str], tuple[int, str]]) -> None:
    code, output = check("Arm", "{length: 100}")
    assert code == 0, output


@pytest.mark.parametrize(
    ("name", "parameters", "text"),
    [
        ("Arm", "{}", "refuses its parameters: KeyError: 'length'; correct `parameters`"),
        ("Slow", "{length: 100}", "its code takes 5"),
        ("Raising", "{length: 100}", "its code failed with ZeroDivisionError"),
        ("Constant", "{length: 100}", "is not its own inverse"),
        ("Missing", "{length: 100}", "cannot be imported"),
    ],
)
def test_code_that_cannot_be_used_is_named_with_its_file(
    check: Callable[[str, str], tuple[int, str]], name: str, parameters: str, text: str
) -> None:
    code, output = check(name, parameters)
    assert code == 2 and text in output and "arm.fleet.yaml" in output, output
    assert "Traceback" not in output
