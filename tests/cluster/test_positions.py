"""Named positions at run time: saved, listed, used by jobs, kept over a restart, and refused with the reason."""

import asyncio

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import JobReport
from orchestrator.model.steps.move import Move
from orchestrator.runtime.virtual.fleet import VirtualFleet


def fleet_with(**positions: dict[str, object]) -> Fleet:
    """The demo fleet with named positions in its file."""
    return Fleet.model_validate(demo_fleet().to_plain() | {"positions": positions})


PLAIN = fleet_with()
FLEET = fleet_with(park={"gantry.x": 0, "gantry.y": 0}, sample={"gantry.x": "120 mm", "stage.u": "5 mm"})


async def positions(fleet: VirtualFleet, *axes: str) -> list[float]:
    states = await fleet.make_client().status()
    return [round(states[axis.partition(".")[0]].axes[axis.partition(".")[2]].position, 3) for axis in axes]


async def refused(call: object) -> Refusal:
    with pytest.raises(Refusal) as caught:
        await call  # type: ignore[misc]
    return caught.value


def test_a_job_by_names_moves_to_the_values_of_its_beginning_and_reports_them() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        by_name = job("[{do: move, to: sample}, {do: move, to: {gantry.y: park}}]")
        report = await outcome(fleet, by_name)
        assert report.state == "done", report.reason
        assert await positions(fleet, "gantry.x", "gantry.y", "stage.u") == [120.0, 0.0, 5.0]
        assert report.positions_used == {
            "sample": {"gantry.x": "120 mm", "stage.u": "5 mm"},
            "park": {"gantry.y": "0 mm"},
        }
        # The names stay in the job, so that it follows what is saved later.
        shown = await client.show_job(report.job_id)
        assert shown.job is not None and shown.job.steps == by_name.steps
        await outcome(fleet, job("[{do: move, to: {gantry.x: 30, stage.u: 7.5}}]"))
        saved = await client.save_position("sample", "gantry.x", "stage.u", description="the second one")
        assert saved.axes == {"gantry.x": "30 mm", "stage.u": "7.5 mm"} and saved.covers_file
        await outcome(fleet, job("[{do: move, to: park}]"))
        again = await client.retry_job(report.job_id)
        second = await client.wait_for_job(again.job_id)
        assert second.state == "done" and second.positions_used["sample"] == {"gantry.x": "30 mm", "stage.u": "7.5 mm"}
        assert await positions(fleet, "gantry.x", "stage.u") == [30.0, 7.5]

    run_fleet(main, FLEET)


def test_values_are_fixed_for_a_run_and_a_waiting_job_takes_those_of_its_own_beginning() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        await client.save_position("here", at={"gantry.x": "10 mm"})
        running = await client.submit(
            job("[{do: dwell, duration: 2 s}, {do: move, to: {gantry.x: 20}}, {do: move, to: here}]")
        )
        waiting = await client.submit(job("[{do: move, to: here}]"))
        await sleep_ns(fleet.clock, NS_PER_S)
        await client.save_position("here", at={"gantry.x": "50 mm"})
        first: JobReport = await client.wait_for_job(running)
        second = await client.wait_for_job(waiting)
        assert [first.positions_used, second.positions_used] == [
            {"here": {"gantry.x": "10 mm"}},
            {"here": {"gantry.x": "50 mm"}},
        ]
        assert (first.state, second.state) == ("done", "done")
        assert await positions(fleet, "gantry.x") == [50.0]

    run_fleet(main, PLAIN)


def test_saved_positions_outlive_a_coordinator_and_removing_one_uncovers_that_of_the_file() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        await outcome(fleet, PREPARE)
        await client.save_position("park", at={"gantry.x": "7 mm"}, description="by hand")
        await client.save_position("zero", "gantry")
        before = await client.list_positions()
        fleet.kill("coordinator/first")
        await sleep_ns(fleet.clock, NS_PER_S)
        fleet.start_coordinator("second")
        await fleet.wait_until(lambda states: all(state.epoch == 2 for state in states.values()))
        assert await client.list_positions() == before
        park = {each.name: each for each in before}["park"]
        assert (park.source, park.covers_file, park.actor, park.description) == ("saved", True, "anna", "by hand")
        assert park.utc is not None and park.utc.endswith("Z")
        assert [(each.name, each.source) for each in before] == [
            ("sample", "file"),
            ("park", "saved"),
            ("zero", "saved"),
        ]
        uncovered = await client.remove_position("park")
        assert uncovered is not None and uncovered.axes == {"gantry.x": 0, "gantry.y": 0}
        assert await client.remove_position("zero") is None
        assert (await refused(client.remove_position("park"))).code == "in-file"
        assert "did you mean park?" in (await refused(client.remove_position("prk"))).text

    run_fleet(main, FLEET)


def test_a_saved_position_is_a_user_position() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 40}}, {do: set-position, axes: {gantry.x: 0}}]"))
        saved = await client.save_position("sample", "gantry.x")
        assert saved.axes == {"gantry.x": "0 mm"}
        report = await outcome(fleet, job("[{do: move, by: {gantry.x: 20}}, {do: move, to: sample}]"))
        assert report.state == "done"
        assert await positions(fleet, "gantry.x") == [0.0]
        # Its limits are those of the motor: 400 mm, 40 of which the offset takes.
        text = (await refused(client.save_position("far", at={"gantry.x": 361}))).text
        assert text == "axis gantry.x: target 361 mm is beyond its soft limits -50 to 360 mm"

    run_fleet(main, PLAIN)


def test_what_cannot_be_saved_is_refused_with_the_reason() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        save = client.save_position
        assert (await refused(save("all"))).text == "no axis of the fleet is referenced"
        unreferenced = await refused(save("a", "gantry.x"))
        assert unreferenced.code == "not-referenced" and "tutti axis home gantry.x" in unreferenced.remedy
        await outcome(fleet, job("[{do: enable, axes: [gantry]}, {do: home, axes: [gantry]}]"))
        assert set((await save("all")).axes) == {"gantry.x", "gantry.y"}
        for name, text in (
            ("gantry", "the name of a controller"),
            ("table", "the name of a group"),
            ("5mm", "is no name of a position"),
            ("nan", "is no name of a position"),
            ("Up", "is no name of a position"),
        ):
            wrong = await refused(save(name, "gantry.x"))
            assert wrong.code == "bad-name" and text in wrong.text, name
        assert (await refused(save("a", "gantry.q"))).code == "unknown-name"
        assert "deg is a unit of angle" in (await refused(save("a", at={"gantry.x": "5 deg"}))).text
        assert (await refused(save("a", at={"gantry.x": 500}))).code == "soft-limit"
        moving = await client.submit(job("[{do: move, to: {gantry.x: 300}, speed: 0.2}]"))
        await sleep_ns(fleet.clock, NS_PER_S)
        assert (await refused(save("a", "gantry"))).text == "axis gantry.x moves"
        assert (await refused(save("a"))).code == "moving"
        assert (await save("a", "gantry.y")).axes == {"gantry.y": "0 mm"}
        await client.wait_for_job(moving)
        fleet.wires["stage"].cut = True
        await fleet.wait_until(lambda states: states["stage"].mode == "offline")
        assert (await refused(save("a", "stage.u"))).code == "offline"

    run_fleet(main, PLAIN)


@pytest.mark.parametrize(
    ("steps", "code", "text"),
    [
        ("[{do: move, to: sampel}]", "unknown-name", "no position sampel; did you mean sample? its positions are: park, "),
        ("[{do: move, to: {gantry.x: sampel}}]", "unknown-name", "no position sampel"),
        ("[{do: move, to: {gantry.y: sample}}]", "not-in-position", "sample has no value for gantry.y; it has: gantry.x"),
        ("[{do: move, to: sample, by: {stage.u: 1}}]", "bad-step", "stage.u is in `by` and in position sample"),
        ("[{do: move, to: {gantry.x: 500}}]", "soft-limit", "beyond"),
    ],
)  # fmt: skip
def test_a_job_with_a_wrong_name_is_refused_when_it_is_submitted(steps: str, code: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        wrong = await refused(fleet.make_client().submit(job(steps)))
        assert wrong.code == code and text in wrong.text
        wrong = await refused(fleet.make_client().dry_run(job(steps))) if code != "soft-limit" else wrong
        assert wrong.code == code

    run_fleet(main, FLEET)


def test_a_job_whose_position_is_removed_while_it_waits_fails_before_anything_moves() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        await client.save_position("here", at={"gantry.x": 10})
        running = await client.submit(job("[{do: dwell, duration: 2 s}, {do: move, to: {gantry.x: 1}}]"))
        waiting = await client.submit(job("[{do: move, to: {gantry.x: 5}}, {do: move, to: here}]"))
        await client.remove_position("here")
        await client.wait_for_job(running)
        report = await client.wait_for_job(waiting)
        assert report.state == "failed" and report.reason.startswith("not begun: the fleet has no position here")
        assert await positions(fleet, "gantry.x") == [1.0]

    run_fleet(main, PLAIN)


def test_a_retry_needs_no_position_of_the_steps_before_its_first() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        await client.save_position("here", at={"gantry.x": 10})
        done = await outcome(fleet, job("[{do: move, to: here}, {do: move, to: {gantry.x: 5}}]"))
        await client.remove_position("here")
        assert (await refused(client.retry_job(done.job_id))).code == "unknown-name"
        again = await client.wait_for_job((await client.retry_job(done.job_id, 1)).job_id)
        assert again.state == "done" and again.positions_used == {}
        assert await positions(fleet, "gantry.x") == [5.0]

    run_fleet(main, PLAIN)


def test_positions_of_an_axis_that_has_changed_are_listed_and_a_job_with_them_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await client.save_position("both", at={"gantry.x": "12 mm", "stage.focus": "20 um"})
        await client.save_position("good", at={"gantry.x": "12 mm"})
        plain = PLAIN.to_plain()
        del plain["controllers"]["stage"]["axes"]["focus"]
        plain["home_order"].remove("stage.focus")
        plain["controllers"]["gantry"]["axes"]["x"] |= {"unit": "deg"}
        assert await client.reload_fleet(Fleet.model_validate(plain)) == ["gantry", "stage"]
        both, good = await client.list_positions()
        assert len(both.problems) == 2 and "no axis stage.focus" in both.problems[1]
        assert good.problems == [
            "gantry.x is 12 mm: mm is a unit of length, and the axis is in deg; use one of: deg, arcmin, arcsec, rad, "
            "mrad, rev"
        ]
        wrong = await refused(client.submit(job("[{do: move, to: good}]")))
        assert wrong.code == "bad-position" and wrong.text.startswith("position good: gantry.x is 12 mm")
        assert "tutti position rm" in wrong.remedy

    run_fleet(main, PLAIN)


def test_a_damaged_position_moves_nothing_and_can_be_replaced() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await client.save_position("park", at={"gantry.x": "12 mm"})
        fleet.journal.database.write("UPDATE positions SET body = replace(body, '12 mm', '92 mm')")
        fleet.kill("coordinator/first")
        await sleep_ns(fleet.clock, NS_PER_S)
        fleet.start_coordinator("second")
        await fleet.wait_until(lambda states: all(state.epoch == 2 for state in states.values()))
        park = (await client.list_positions())[-1]
        # Not that of the file, which is another place.
        assert (park.name, park.axes, park.covers_file) == ("park", {}, True)
        wrong = await refused(client.submit(job("[{do: move, to: park}]")))
        assert wrong.code == "bad-position" and "damaged" in wrong.text
        await client.save_position("park", at={"gantry.x": "12 mm"})
        assert (await client.list_positions())[-1].problems == []

    run_fleet(main, FLEET)


def test_the_verbs_of_python_take_names() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        assert Move(to="sample").to == {"*": "sample"}
        await client.move(to="sample")
        assert await positions(fleet, "gantry.x", "stage.u") == [120.0, 5.0]
        await client.move(to={"gantry.x": "park"})
        assert await positions(fleet, "gantry.x", "stage.u") == [0.0, 5.0]

    run_fleet(main, FLEET)


def test_a_full_disk_saves_nothing_and_says_so() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        fleet.coordinator_disk.full = True
        assert (await refused(client.save_position("here", at={"gantry.x": 1}))).code == "journal"
        fleet.coordinator_disk.full = False
        assert await client.list_positions() == []
        await asyncio.gather(*(client.save_position(f"p{number}", at={"gantry.x": number}) for number in range(5)))
        assert len(await client.list_positions()) == 5

    run_fleet(main, PLAIN)
