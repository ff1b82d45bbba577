"""Programs in G-code by the gateway: what is chosen, seen and confirmed, and how one goes on from where it stood."""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from cluster.gateway_client import VirtualGateway, run_with_gateway
from cluster.worlds import EXAMPLES, PREPARE, outcome

from orchestrator.model.jobs.files import FileError
from orchestrator.model.jobs.job import Job
from orchestrator.runtime.virtual.fleet import VirtualFleet

PART = (EXAMPLES / "part.ngc").read_text()
CHOSEN = {"spindle": "none", "tools": "none"}


async def check(gateway: VirtualGateway, text: str = PART, continues: str = "", **values: str) -> dict[str, Any]:
    body = {"program": {"name": "part.ngc", "text": text}, "values": values}
    answer = await gateway.post("/v1/check-job", body | ({"continues": continues} if continues else {}))
    assert answer.status == 200, answer.json
    return answer.json


async def run(fleet: VirtualFleet, gateway: VirtualGateway, checked: dict[str, Any]) -> None:
    assert checked["problems"] == []
    job_id = (await gateway.post("/v1/submit", {"job": checked["job"]})).json["job_id"]
    report = await fleet.make_client().wait_for_job(job_id)
    assert report.state == "done", report.reason


async def open_gateway(fleet: VirtualFleet, folder: Path) -> VirtualGateway:
    gateway = VirtualGateway(fleet, folder, {})
    await gateway.start()
    await outcome(fleet, PREPARE)
    return gateway


def test_a_program_is_checked_drawn_and_run(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        refused = await check(gateway)
        assert [(each["line"], each["place"]) for each in refused["problems"]] == [
            *((4, "column 1"), (5, "column 1"), (11, "column 1"))
        ]
        assert [field["name"] for field in refused["parameters"]][:3] == ["X", "Y", "from line"]
        assert [field["default"] for field in refused["parameters"]][:2] == ["gantry.x", "gantry.y"]
        checked = await check(gateway, **CHOSEN)
        program = checked["program"]
        assert [text.partition(":")[0] for text in program["confirm"]] == ["spindle", "tools"]
        x, y = program["extents"]
        assert (x["min"], x["max"], x["limits"], x["over"]) == (0, 40, [-10, 400], 0) and y["max"] == 30
        assert program["drawing"]["rapid"].count("L") == 1 and program["drawing"]["feed"].count("L") > 20
        assert checked["preview"]["duration_s"] > 2
        assert checked["job"]["steps"][0]["name"] == "lines 7 to 10"
        await run(fleet, gateway, checked)
        absent = await check(gateway, **CHOSEN, X="gantry.q")
        assert "is 'gantry.q'; choose one of: not chosen, gantry.x" in absent["problems"][0]["text"]
        far = await check(gateway, "G0 X10\nG0 X10 Y320")
        assert far["program"]["extents"][1]["over"] == 20
        assert (far["problems"][0]["line"], "soft limit" in far["problems"][0]["text"]) == (2, True)

    run_with_gateway(main)


def test_a_program_that_probes_asks_for_the_input(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        text = "G91\nG38.2 Y-3 F60\nG92 Y0\nG0 Y5\nG90 G0 X4"
        refused = await check(gateway, text)
        assert (refused["problems"][0]["line"], "needs the input of the probe" in str(refused["problems"])) == (2, True)
        (field,) = [field for field in refused["parameters"] if field["name"] == "probe"]
        assert field["choices"] == ["not chosen", "gantry.door", "gantry.touch"]
        # Not the latch of the axis: the controller's program stops it.
        assert not (await check(gateway, text, probe="gantry.door"))["problems"]
        checked = await check(gateway, text, probe="gantry.touch")
        assert not checked["problems"] and [step["do"] for step in checked["job"]["steps"]] == [
            *("probe", "move", "set-position", "path")
        ]
        kept = "line 3 sets the user position of gantry.y, which stays behind the program"
        assert kept in checked["program"]["notes"]
        # It touches nothing, and goes on at its probe, not behind the zero that it has not set.
        client = fleet.make_client()
        job_id = (await gateway.post("/v1/submit", {"job": checked["job"]})).json["job_id"]
        assert (await client.wait_for_job(job_id)).state == "failed"
        again = await check(gateway, text, continues=job_id)
        assert [field["default"] for field in again["parameters"] if field["name"] == "from line"] == ["2"]

    run_with_gateway(main)


def test_a_program_begins_at_a_line_after_a_move_to_it(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        checked = await check(gateway, **CHOSEN, **{"from line": "9"})
        program = checked["program"]
        assert program["approach"] == "all axes go straight and together: gantry.x to 30 mm, gantry.y to 10 mm"
        assert "line 9 begins with work offset G54, tool 1, spindle M3 S5000" in program["confirm"][-1]
        assert [step["do"] for step in checked["job"]["steps"]] == ["move"]
        assert [step["do"] for step in checked["forecast"]["steps"]] == ["move", "path"]
        await run(fleet, gateway, checked)
        checked = await check(gateway, **program["values"])
        assert checked["program"]["approach"] == ""
        assert [step["do"] for step in checked["job"]["steps"]] == ["path"]
        await run(fleet, gateway, checked)

    run_with_gateway(main)


LAPS = "G21 G90 F3000\nG1 X40 Y0\nG1 X40 Y40\nG1 X0 Y40\nG1 X0 Y0\n" * 2


async def stop_midway(fleet: VirtualFleet, gateway: VirtualGateway, verb: str, part: float) -> str:
    """Run the laps, and stop them after a part of their time; the id of the job."""
    checked = await check(gateway, LAPS)
    job_id = (await gateway.post("/v1/submit", {"job": checked["job"]})).json["job_id"]
    while not fleet.controllers["gantry"].is_moving("X"):
        await asyncio.sleep(0.01)
    await asyncio.sleep(checked["preview"]["duration_s"] * part)
    await gateway.post(f"/v1/{verb}", {"job_id": job_id} if verb == "cancel" else {})
    report = await fleet.make_client().wait_for_job(job_id)
    assert report.state != "done" and report.parameters_used["program"] == "part.ngc"
    await asyncio.sleep(1)
    await gateway.post("/v1/reset", {})
    return job_id


def test_a_program_goes_on_from_the_line_where_it_stood(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        job_id = await stop_midway(fleet, gateway, "estop", 0.7)  # on the second lap, in line 8
        await outcome(fleet, PREPARE)  # the axes are somewhere else then
        changed = await check(gateway, LAPS + "G0 X1\n", job_id)
        assert "the text is not that of 'part.ngc' as it ran" in changed["problems"][0]["text"]
        moved = await check(gateway, LAPS, job_id, G54="1, 0")
        assert "'G54' is '1, 0' and was '0, 0'" in moved["problems"][0]["text"]
        back = await check(gateway, LAPS, job_id)
        assert back["program"]["line"] == 8 and "gantry.x to 40 mm" in back["program"]["approach"]
        await run(fleet, gateway, back)
        rest = await check(gateway, LAPS, job_id)
        assert rest["program"]["approach"] == "" and rest["job"]["steps"][0]["name"] == "lines 8 to 10"
        await run(fleet, gateway, rest)

    run_with_gateway(main)


def test_a_program_of_the_page_goes_on_by_command(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        job_id = await stop_midway(fleet, gateway, "estop", 0.7)
        await outcome(fleet, PREPARE)
        client, path = fleet.make_client(), tmp_path / "part.ngc"
        path.write_text(LAPS + "G0 X1\n")
        with pytest.raises(FileError, match=r"the text is not that of 'part\.ngc' as it ran"):
            await client.find_rest(job_id, path)
        path.write_text(LAPS)
        rest = await client.find_rest(job_id, path)
        assert (rest.line, rest.place, rest.is_recorded) == (8, "line 8 of part.ngc", True)
        assert [(way.axis, way.to) for way in rest.way] == [("gantry.x", 40), ("gantry.y", 0)]
        assert rest.confirm[-1].startswith("line 8 begins with work offset G54")
        assert rest.move is not None
        await client.run(rest.move)
        await client.start_queue()
        report = await client.wait_for_job(await client.continue_job(rest))
        assert report.state == "done" and report.steps[0].name == "lines 8 to 10"

    run_with_gateway(main)


def test_a_cancelled_program_goes_on_by_where_its_axes_stand(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        job_id = await stop_midway(fleet, gateway, "cancel", 0.25)
        back = await check(gateway, LAPS, job_id)
        assert back["program"]["line"] == 3
        assert "as the job kept no record" in back["parameters"][2]["description"]

    run_with_gateway(main)


@pytest.mark.parametrize(
    "body",
    [
        {"program": "G0 X1"},
        {"program": {"name": "a.ngc"}},
        {"program": {"name": "a.ngc", "text": "G0 X1"}, "text": "a"},
        {"program": {"name": "a.ngc", "text": "G0 X1"}, "continues": 3},
        {"program": {"name": "a.ngc", "text": "G0 X1"}, "continues": "none"},
        {"program": {"name": "a.ngc", "text": "G0 X1"}, "values": []},
    ],
)
def test_what_is_no_program_is_refused(tmp_path: Path, body: dict[str, Any]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = VirtualGateway(fleet, tmp_path, {})
        await gateway.start()
        assert (await gateway.post("/v1/check-job", body)).status in (400, 404, 409)

    run_with_gateway(main)


SQUARE = {
    "schema": "tutti.job/1",
    "name": "square",
    "steps": [
        {"do": "output", "output": "gantry.lamp", "value": True},
        {
            "do": "path",
            "axes": ["gantry.x", "gantry.y"],
            "start": [0, 0],
            "tolerance": "100 um",
            "speed": "10 mm/s",
            "pieces": [{"piece": "line", "to": [20, 0]}, {"piece": "line", "to": [20, 20]}],
        },
    ],
}
SCAN = {
    "schema": "tutti.job/1",
    "name": "row",
    "steps": [
        SQUARE["steps"][0],
        {
            "do": "scan",
            "axes": {"gantry.x": {"from": 0, "to": 40, "points": 5}},
            "at_each": [{"do": "dwell", "duration": "500 ms"}],
        },
    ],
}


async def stop_job(fleet: VirtualFleet, gateway: VirtualGateway, plain: dict[str, Any], at: float) -> str:
    """Run a job until the first axis is there, and end it by an e-stop; its id. The axes are at 0 again."""
    job_id: str = (await gateway.post("/v1/submit", {"job": plain})).json["job_id"]
    client = fleet.make_client()
    while await client.position("gantry.x") < at:
        await asyncio.sleep(0.02)
    await gateway.post("/v1/estop", {})
    await client.wait_for_job(job_id)
    await asyncio.sleep(1)
    await gateway.post("/v1/reset", {})
    await outcome(fleet, PREPARE)
    return job_id


async def ask_rest(gateway: VirtualGateway, job_id: str) -> dict[str, Any]:
    answer = await gateway.post("/v1/check-job", {"continues": job_id})
    assert answer.status == 200, answer.json
    return answer.json


def test_a_path_goes_on_after_two_confirmations(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        job_id = await stop_job(fleet, gateway, SQUARE, 8)
        back = await ask_rest(gateway, job_id)
        assert back["program"]["approach"].startswith("all axes go straight and together: gantry.x to ")
        assert [step["do"] for step in back["job"]["steps"]] == ["move"]
        await run(fleet, gateway, back)
        await gateway.post("/v1/submit", {"job": {**SQUARE, "steps": [{**SQUARE["steps"][0], "value": False}]}})
        await asyncio.sleep(1)
        rest = await ask_rest(gateway, job_id)
        assert rest["program"]["approach"] == ""
        assert rest["program"]["confirm"][0].startswith("square stood at step 2 (path), piece 1 of 2")
        assert rest["program"]["confirm"][1:] == ["gantry.lamp is switched on"]
        assert [step["do"] for step in rest["job"]["steps"]] == ["output", "path"]
        await run(fleet, gateway, rest)

    run_with_gateway(main)


def test_a_scan_goes_on_by_a_re_run(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        job_id = await stop_job(fleet, gateway, SCAN, 12)
        await outcome(fleet, Job.model_validate({**SCAN, "steps": [{**SCAN["steps"][0], "value": False}]}))
        back = await ask_rest(gateway, job_id)
        assert "gantry.x to 20 mm" in back["program"]["approach"]
        await run(fleet, gateway, back)
        switch = await ask_rest(gateway, job_id)
        assert switch["program"]["approach"] == "gantry.lamp is switched on"
        await run(fleet, gateway, switch)
        rest = await ask_rest(gateway, job_id)
        retry = rest["program"]["retry"]
        assert (rest["job"], retry) == (None, {"job_id": job_id, "from_step": 1, "from_point": 3})
        retried = await gateway.post("/v1/retry", {**retry, "terms": rest["program"]["terms"]})
        report = await fleet.make_client().wait_for_job(retried.json["job_id"])
        assert report.state == "done" and report.steps[0].scan is not None and report.steps[0].scan.done == 3

    run_with_gateway(main)
