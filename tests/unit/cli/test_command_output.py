"""What commands answer: names and positions, times, narrow terminals, terminals without special signs."""

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from cluster.worlds import demo_job, job
from rich.console import Console
from rich.text import Text
from unit.cli.command_world import CommandWorld, open_world
from unit.cli.local_time import use_berlin_time

from orchestrator.cli.base.encoding import replace_unknown_signs
from orchestrator.model.report import JobReport, StepChain, StepReport
from orchestrator.monitor.report_table import make_report_tables
from orchestrator.monitor.tables import make_plain_table
from orchestrator.monitor.times import format_time, localize_times, show_utc


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[CommandWorld]:
    yield from open_world(monkeypatch)


@pytest.fixture
def berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    yield from use_berlin_time(monkeypatch)
    show_utc(wanted=False)


def test_manual_commands_answer_with_names_and_positions(world: CommandWorld) -> None:
    assert world.done("axis", "enable", "gantry") == "enabled: gantry.x 0.000 mm, gantry.y 0.000 mm"
    assert world.done("axis", "home", "gantry").startswith("homed: gantry.x ")
    assert world.done("axis", "move", "gantry.x=12.5", "gantry.y=3mm") == "gantry.x 12.500 mm, gantry.y 3.000 mm"
    assert world.done("axis", "set-position", "gantry.x=0") == "gantry.x 0.000 mm"
    assert world.done("io", "set", "gantry.lamp", "on") == "gantry.lamp is on"
    moved = json.loads(world.done("axis", "move", "gantry.x=1", "--json"))
    assert moved["state"] == "done"
    assert moved["axes"]["gantry.x"] == {"position": 1.0, "unit": "mm", "enabled": True, "referenced": True}
    assert "gantry.x: soft limits" in world.done("axis", "limits", "table")


@pytest.mark.parametrize("command", ["axis move stage.u=6", "axis enable gantry", "axis home", "axis move gantry.x=1"])
def test_a_latched_estop_is_the_first_reason(world: CommandWorld, command: str) -> None:
    world.wait(world.fleet.make_client("boris").estop("hand in the machine"))
    said = world.refused(1, *command.split())
    assert said.splitlines()[0] == "tutti: e-stop by boris: hand in the machine"
    assert "tutti reset" in said
    assert "job file" not in said and "step" not in said
    assert "e-stop" in world.done("status").splitlines()[1]
    assert "e-stop" in world.done("axis", "ls").splitlines()[1]


def test_jobs_are_named_by_prefix_by_name_and_as_last(world: CommandWorld) -> None:
    client = world.fleet.make_client()
    first = world.wait(client.submit(job("[{do: dwell, duration: 1 s}]")))
    last = world.wait(client.submit(job("[{do: dwell, duration: 2 s}]").model_copy(update={"name": "other"})))
    world.let_pass(5)
    assert f"job 'other' {last.id} of client: done" in world.done("job", "show", "last")
    for reference in (first.id, first.id[:6], "test"):
        assert f"job 'test' {first.id}" in world.done("job", "report", reference)
    again = world.wait(client.submit(job("[{do: dwell, duration: 9 s}]")))
    assert f"several jobs fit 'test': {again.id} 'test', {first.id} 'test'" in world.refused(2, "job", "show", "test")
    # A report is of the newest job of that name.
    assert f"job 'test' {again.id} has not ended" in world.refused(1, "job", "report", "test")
    assert world.done("job", "cancel", "last") == f"job 'test' {again.id} is cancelled"
    assert f"job 'test' {again.id}: cancelled" in world.done("job", "report", "test")


def test_enable_without_names_takes_the_fleet_and_disable_asks_for_them(world: CommandWorld) -> None:
    axes = set(json.loads(world.done("axis", "enable", "--json"))["axes"])
    assert axes == set(world.fleet.fleet.axis_names)
    assert "tutti axis disable all" in world.refused(2, "axis", "disable")
    assert set(json.loads(world.done("axis", "disable", "all", "--json"))["axes"]) == axes
    for name, state in world.wait(world.fleet.make_client().status()).items():
        assert not any(axis.enabled for axis in state.axes.values()), name


def test_a_space_or_minus_that_looks_like_another_one_is_named(world: CommandWorld) -> None:
    assert "it has a minus sign of typography (U+2212)" in world.refused(2, "axis", "move", "gantry.x=\u22125")
    assert "it has a non-breaking space (U+00A0)" in world.refused(2, "axis", "move", "gantry.x=5\u00a0mm")
    assert "'gantry\\t'; it has a tab (U+0009)" in world.refused(2, "axis", "enable", "gantry\t")


def test_a_fleet_file_is_no_job_to_submit(world: CommandWorld) -> None:
    said = world.refused(2, "submit", str(Path(__file__).parents[3] / "deploy/examples/demo.fleet.yaml"))
    assert "this is a fleet file; a job file is needed here" in said


def test_a_job_waits_for_the_one_that_after_means(world: CommandWorld, tmp_path: os.PathLike[str]) -> None:
    path = os.path.join(tmp_path, "a.job.json")  # noqa: PTH118
    with open(path, "w") as file:  # noqa: PTH123
        file.write(demo_job().to_json().decode())
    first = json.loads(world.done("submit", path, "--hold", "--json"))["job_id"]
    second = json.loads(world.done("submit", path, "--hold", "--after", "last", "--json"))["job_id"]
    assert f"after job {first}" in world.done("job", "show", second)


def test_times_are_local_with_their_offset(world: CommandWorld, berlin: None, monkeypatch: pytest.MonkeyPatch) -> None:
    world.done("axis", "enable", "gantry")
    assert "2026-01-01 01:00:0" in world.done("job", "ls")
    assert "+01:00" in world.done("job", "show", "last")
    assert "2026-01-01 00:00:0" in world.done("job", "ls", "--utc")
    monkeypatch.setenv("TUTTI_UTC", "1")
    assert "Z queued" in world.done("job", "show", "last")
    assert "T00:00:0" in world.done("job", "ls", "--json")


def test_a_time_can_be_given_back(berlin: None) -> None:
    stamp = "2026-07-25T20:24:05.123456Z"
    assert format_time(stamp) == "2026-07-25 22:24:05+02:00"
    assert format_time(stamp, precise=True) == "2026-07-25 22:24:05.123+02:00"
    assert format_time(format_time(stamp)) == format_time(stamp)
    assert localize_times(f"waits until {stamp}, or so") == "waits until 2026-07-25 22:24:05+02:00, or so"
    show_utc(wanted=True)
    assert format_time(stamp) == "2026-07-25 20:24:05Z"
    assert format_time("not known") == "not known"


def render(item: object, columns: int) -> str:
    console = Console(width=columns, height=24, color_system=None)
    with console.capture() as drawn:
        console.print(item)
    return drawn.get()


def test_a_narrow_terminal_gets_stacked_rows() -> None:
    table = make_plain_table(["axis", "position>", "name"], shrinking=("name",))
    table.add_row("gantry.x", "120.000 mm", Text("a name of some length", no_wrap=True, overflow="ellipsis"))
    table.add_note("the reason")
    table.add_row("", "3.000 mm", "")
    wide = render(table, 80).splitlines()
    assert [line.split()[0] for line in wide] == ["axis", "gantry.x", "the", "3.000"]
    assert len(render(table, 37).splitlines()) == 4
    narrow = render(table, 20).splitlines()
    assert [line.rstrip() for line in narrow] == [
        "axis      gantry.x",
        "position  120.000 mm",
        "name      a name of…",
        "          the reason",
        "",
        "position  3.000 mm",
    ]


@pytest.mark.parametrize("columns", [20, 40, 80, 200])
def test_no_command_loses_figures_on_a_narrow_terminal(
    world: CommandWorld, monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    for words in (["status"], ["axis", "ls"], ["clock", "ls"], ["io", "ls"]):
        shown = world.done(*words)
        assert "…" not in shown, shown
        assert max(map(len, shown.splitlines())) <= columns


def test_an_encoding_without_signs_replaces_them(monkeypatch: pytest.MonkeyPatch) -> None:
    import io
    import sys

    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, "ascii"))
    replace_unknown_signs()
    sys.stdout.write("±0.75 ms → ok … 20 µm ☃\n")
    sys.stdout.flush()
    assert written.getvalue() == b"~0.75 ms > ok . 20 um ?\n"


def test_the_signs_of_the_command_have_a_plain_form(world: CommandWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    for sign in set(world.done("status") + world.done("clock", "ls")):
        assert ord(sign) < 128 or sign in "±→←↑↓▸▶◀■…≤≥−–—━─╸╺µμ°∞·×"


def make_report(steps: list[StepReport]) -> JobReport:
    return JobReport(
        job_id="3f2a91c0", name="scan", actor="anna", state="done", reason="", epoch=1, submitted_utc="",
        max_start_skew_ns=10, steps=steps,
    )  # fmt: skip


def test_a_short_report_fits_a_terminal_and_begins_with_the_verdict() -> None:
    steps = [StepReport(index=i, do="move", name="there", state="done", verdict="green") for i in range(200)]
    steps[150] = steps[150].model_copy(update={"verdict": "amber", "deviations": ["took 2 ms longer"]})
    lines = render(make_report_tables(make_report(steps)), 80).splitlines()
    assert lines[0] == "job 'scan' 3f2a91c0: done, verdict amber"
    assert len(lines) <= 22
    assert any(line.split()[:1] == ["151"] for line in lines)
    assert "and 186 more steps, which are done as planned" in lines
    assert "step 151: took 2 ms longer" in lines
    assert len(render(make_report_tables(make_report(steps), detailed=True), 80).splitlines()) > 200


def make_chained(index: int, chain: StepChain | None) -> StepReport:
    return StepReport(index=index, do="move", name="there", state="done", verdict="green", chain=chain)


def test_a_report_states_the_gaps_between_steps_and_why_others_began_from_rest() -> None:
    waited = StepChain(step=2, kept=False, gap_s=0.64, broken="step 4 (wait) comes before it")
    kept = [StepChain(step=index, kept=True, gap_s=0.012 + index / 1000) for index in range(2)]
    steps = [make_chained(0, None), *(make_chained(chain.step + 1, chain) for chain in kept), make_chained(4, waited)]
    lines = render(make_report_tables(make_report(steps)), 120).splitlines()
    place = lines.index(
        "begun right behind the motion before: 2 of 3 steps, 12.5 ms after its end in the median, 13.0 ms at most"
    )
    assert lines[place + 1] == "step 5 from rest, 0.640 s after step 3: step 4 (wait) comes before it"


def test_job_show_tells_of_each_step_how_it_followed_the_one_before(world: CommandWorld) -> None:
    for words in ("enable gantry", "home gantry"):
        world.done("axis", *words.split())
    move, wait = "{do: move, to: {gantry.x: %d}}", "{do: wait, input: gantry.door, value: false, timeout: 1 s}"
    world.wait(world.fleet.make_client().submit(job(f"[{move % 20}, {move % 0}, {wait}, {move % 20}]")))
    world.let_pass(10)
    steps = [line.strip() for line in world.done("job", "show", "last").splitlines() if line.startswith("  ")]
    ends = [line.partition(": done")[2] for line in steps[-4:]]
    assert ends[0] == ends[2] == ""
    assert re.fullmatch(r", \d\.\d ms after step 1", ends[1])
    assert ends[3] == ", from rest: step 3 (wait) comes before it"


def test_a_short_report_has_few_lines_about_steps_from_rest() -> None:
    broken = StepChain(step=0, kept=False, broken="the job is paused")
    steps = [make_chained(0, None), *(make_chained(index, broken) for index in range(1, 30))]
    counts = [
        render(make_report_tables(make_report(steps), detailed=detailed), 80).count("from rest: the job is paused")
        for detailed in (False, True)
    ]
    assert counts == [4, 29]


def test_a_report_of_single_moves_says_nothing_about_gaps() -> None:
    said = render(make_report_tables(make_report([make_chained(0, None)])), 80)
    assert "behind" not in said and "from rest" not in said


def test_the_report_of_a_move_has_its_members_with_v(world: CommandWorld) -> None:
    for words in ("enable gantry stage", "home gantry", "move gantry.x=10"):
        world.done("axis", *words.split())
    short, full = world.done("job", "report", "last"), world.done("job", "report", "last", "-v")
    assert "verdict green" in short.splitlines()[0]
    assert len(short.splitlines()) < 24
    assert "Start after T0: predicted by term and all together, and measured:" not in short
    assert "Start after T0: predicted by term and all together, and measured:" in full
    assert "predicted" in short.splitlines()[2]


def test_a_predicted_skew_is_named_as_such_beside_a_measured_one(world: CommandWorld) -> None:
    for words in ("enable gantry stage", "home gantry stage", "move gantry.x=10 stage.u=1"):
        world.done("axis", *words.split())
    full = world.done("job", "report", "last", "-v").splitlines()
    ends = [line for line in full if " end skew at most" in line]
    assert ends and all(line.startswith("step 1: predicted end skew at most ") for line in ends)
