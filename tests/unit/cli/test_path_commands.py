"""`tutti path plot`: a path as a picture before it runs, and what it says instead of one."""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from orchestrator.cli.main import main as command

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "demo.fleet.yaml"
PATH = (
    "{do: path, axes: [gantry.x, gantry.y], start: [150, 100], speed: 100 mm/s, tolerance: 100 um, "
    "pieces: [{piece: arc, to: [50, 100], centre: [100, 100]}, {piece: line, to: [50, 40]}]}"
)


@pytest.fixture(name="fleet")
def make_fleet(tmp_path: Path) -> Path:
    """The demo fleet, whose gantry has a jerk limit."""
    file = tmp_path / "lab.fleet.yaml"
    file.write_text(EXAMPLE.read_text().replace("acceleration: 1000}", "acceleration: 1000, jerk: 20000}"))
    return file


def plot(fleet: Path, steps: str, *options: str) -> Result:
    file = fleet.with_name("part.job.yaml")
    file.write_text(f"schema: tutti.job/1\nname: part\nsteps: [{steps}]\n")
    return CliRunner().invoke(command, ["path", "plot", str(file), "--fleet", str(fleet), *options])


def test_a_path_is_drawn_with_what_limits_it(fleet: Path) -> None:
    result = plot(fleet, f"{{do: home}}, {{do: move, to: {{gantry.x: 150, gantry.y: 100}}}}, {PATH}")
    assert result.exit_code == 0, result.output
    assert "path of 217.08 mm in" in result.output and "speed along the path" in result.output
    assert fleet.with_name("part.job.png").read_bytes().startswith(b"\x89PNG")


def test_an_axis_that_stands_elsewhere_is_named(fleet: Path) -> None:
    result = plot(fleet, f"{{do: home}}, {PATH}")
    assert result.exit_code == 2 and "gantry.x is at 0 mm; the path begins at 150 mm" in result.output
    placed = plot(fleet, PATH, "--at", "gantry.x=150", "--at", "gantry.y=100", "-o", str(fleet.with_suffix(".svg")))
    assert placed.exit_code == 0, placed.output


@pytest.mark.parametrize(
    ("steps", "options", "words"),
    [
        ("{do: home}", (), "has no step `do: path`"),
        (
            f"{{do: home}}, {PATH}",
            ("--step", "1"),
            "step 1 of job 'part' is no path, and no scan that flies its paths, and scans that fly, are the steps 2",
        ),
        (PATH.replace("gantry.y", "gantry.z"), (), "the fleet has no axis gantry.z"),
        (PATH.replace("[50, 40]", "[50, -40]"), (), "below its soft limit -10"),
        (PATH.replace("100 um", "0"), (), "the tolerance is 0; it must be above 0"),
        (PATH.replace("gantry.y", "stage.focus"), (), "the axes of a path must have one unit"),
    ],
)
def test_what_cannot_be_drawn_is_said(fleet: Path, steps: str, options: tuple[str, ...], words: str) -> None:
    result = plot(fleet, steps, *options)
    assert result.exit_code == 2 and words in " ".join(result.output.split()), result.output
