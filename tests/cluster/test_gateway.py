"""The gateway in virtual time: stream, jogs, one-step jobs, and what ends with a socket."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from cluster.gateway_client import Socket, VirtualGateway, run_with_gateway
from cluster.worlds import PREPARE, demo_fleet, outcome

from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.report import QueueState
from orchestrator.runtime.virtual.fleet import VirtualFleet

VALID_NS = 200 * NS_PER_MS
LEASE_ENDS_S = 3.0
RAMP_NS = 60 * NS_PER_MS  # latency of the stop, the ramp at 20 mm/s, one poll


async def open_gateway(fleet: VirtualFleet, folder: Path) -> tuple[VirtualGateway, Socket]:
    gateway = VirtualGateway(fleet, folder)
    await gateway.start()
    return gateway, await gateway.connect()


async def begin_jog(fleet: VirtualFleet, socket: Socket, seconds: float = 0.5) -> None:
    """Acquire gantry.x, and jog it; the last renewal is just sent."""
    assert "ok" in await socket.ask("acquire", axes=["gantry.x"])
    assert "ok" in await socket.ask("jog", axis="gantry.x", velocity=20)
    for _ in range(round(seconds / 0.1)):
        await asyncio.sleep(0.1)
        assert "ok" in await socket.ask("renew")
    assert fleet.controllers["gantry"].is_moving("X")


async def find_end_ns(fleet: VirtualFleet) -> int:
    """When gantry.x came to rest."""
    gantry = fleet.controllers["gantry"]
    while gantry.is_moving("X"):
        await asyncio.sleep(0.002)
    ends = [each.end_ns for each in gantry.commanded_motions if each.axis == "X"]
    assert ends[-1] is not None
    return ends[-1]


def test_the_stream_gives_the_state_and_differences_that_lead_to_the_present_one(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway, socket = await open_gateway(fleet, tmp_path)
        assert socket.frames[0]["hello"]["role"] == "operator"
        assert not socket.frames[0]["hello"]["users"]
        await outcome(fleet, PREPARE)
        await asyncio.sleep(1.0)
        assert socket.gaps == 0
        assert socket.whole == 1
        axis = socket.state["controllers"]["gantry"]["axes"]["x"]
        assert axis["referenced"] and axis["enabled"]
        assert (axis["min"], axis["max"], axis["unit"]) == (-10.0, 400.0, "mm")
        assert axis["manual_speed"] == 0.2
        other = await gateway.connect()
        await asyncio.sleep(0.2)
        without_time = [{key: value for key, value in each.state.items() if key != "utc"} for each in (socket, other)]
        assert without_time[0] == without_time[1]
        assert (await gateway.get("/v1/state")).json["controllers"].keys() == {"gantry", "stage"}

    run_with_gateway(main)


def test_there_are_at_most_20_differences_a_second_and_at_least_2(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        _, socket = await open_gateway(fleet, tmp_path)
        bus, begin = fleet.make_client().bus, socket.number or 0
        for number in range(400):
            bus.put(fleet.keys.queue, QueueState(jobs=[], waiting=number).to_json())
            await asyncio.sleep(0.005)
        assert 36 <= (socket.number or 0) - begin <= 41

    run_with_gateway(main)


def test_what_is_old_says_so_and_a_difference_comes_twice_a_second_all_the_same(tmp_path: Path) -> None:
    async def main(clock: VirtualClock) -> None:
        fleet = VirtualFleet(demo_fleet(), clock, guardian=False)
        await fleet.start()
        _, socket = await open_gateway(fleet, tmp_path)
        for name in (*(f"host/{each}" for each in fleet.hosts), "coordinator/first"):
            fleet.freeze(name)
        await asyncio.sleep(1.5)
        begin = socket.number or 0
        await asyncio.sleep(3.0)
        assert 6 <= (socket.number or 0) - begin <= 12
        assert not socket.state["coordinator"]["present"]
        assert socket.state["controllers"]["gantry"]["age_s"] >= 4
        for name in (*(f"host/{each}" for each in fleet.hosts), "coordinator/first"):
            fleet.resume(name)
        await VirtualGateway.started.pop().close()

    run_virtual(main)


def test_a_reader_that_stops_reading_gets_the_newest_state_when_it_reads_again(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway, socket = await open_gateway(fleet, tmp_path)
        socket.reads = False
        await outcome(fleet, PREPARE)
        sent = socket.sent
        socket.reads = True
        await asyncio.sleep(0.5)
        assert socket.whole == 2
        assert socket.gaps == 0
        assert socket.state["controllers"]["gantry"]["axes"]["x"]["referenced"]
        assert socket.sent - sent < 20_000  # not all that it has missed
        assert gateway.gateway.hub.readers == 1

    run_with_gateway(main)


def test_a_reader_that_never_reads_is_disconnected(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway, socket = await open_gateway(fleet, tmp_path)
        socket.reads = False
        await asyncio.sleep(20.0)
        assert gateway.gateway.hub.readers == 0

    run_with_gateway(main)


def test_a_gap_is_healed_on_request(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        _, socket = await open_gateway(fleet, tmp_path)
        socket.state, socket.number = {}, -5
        socket.send("resync")
        await socket.wait_for(lambda: socket.state)
        assert socket.whole == 2

    run_with_gateway(main)


def test_a_jog_that_is_let_go_decelerates_at_once(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        _, socket = await open_gateway(fleet, tmp_path)
        await begin_jog(fleet, socket)
        let_go_ns = fleet.clock.now_ns()
        socket.send("end-jog")
        assert await find_end_ns(fleet) - let_go_ns < RAMP_NS

    run_with_gateway(main)


def test_the_end_of_a_jog_is_one_request_to_the_controller_without_a_pause(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        gateway, socket = await open_gateway(fleet, tmp_path)
        await begin_jog(fleet, socket)
        sent: list[tuple[int, str]] = []
        bus = gateway.gateway.hub._tutti.bus
        request = bus.request

        async def note_request(key: str, payload: bytes, *rest: Any) -> bytes:
            if key.endswith("/cmd/jog"):
                sent.append((fleet.clock.now_ns(), json.loads(payload)["velocities"]))
            return await request(key, payload, *rest)

        bus.request = note_request  # type: ignore[method-assign]
        let_go_ns = fleet.clock.now_ns()
        socket.send("end-jog")
        await find_end_ns(fleet)
        assert sent == [(let_go_ns, {"x": 0.0})]

    run_with_gateway(main)


@pytest.mark.parametrize("end", ["closed", "silent", "killed", "end-of-gateway"])
def test_a_jog_ends_with_its_socket(tmp_path: Path, end: str) -> None:
    """closed: the other side has closed it. silent: it is open, and no frame comes. killed: the gateway is."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        gateway, socket = await open_gateway(fleet, tmp_path)
        await begin_jog(fleet, socket)
        ended_ns = fleet.clock.now_ns()
        if end == "closed":
            socket.close()
        elif end == "killed":
            gateway.process.kill()
        elif end == "end-of-gateway":
            await gateway._run_inside(gateway.gateway.close())
        took_ns = await find_end_ns(fleet) - ended_ns
        assert took_ns < (RAMP_NS if end in ("closed", "end-of-gateway") else VALID_NS + RAMP_NS)
        await asyncio.sleep(LEASE_ENDS_S)
        async with fleet.make_client("other").manual_control(["gantry.x"]):
            pass

    run_with_gateway(main)


def test_axes_are_released_when_a_page_sends_nothing_for_a_second(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        _, socket = await open_gateway(fleet, tmp_path)
        await socket.ask("acquire", axes=["gantry.x"])
        for _ in range(20):
            await asyncio.sleep(0.3)
            socket.send("alive")
        assert "gantry.x" in socket.state["leases"] or "gantry" in socket.state["leases"]
        await asyncio.sleep(1.5)
        assert socket.find_kind("manual")["lost"]["code"] == "silent"
        await asyncio.sleep(0.5)
        assert not socket.state["leases"]

    run_with_gateway(main)


def test_a_one_step_job_ends_with_the_socket_that_waits_for_it(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        _, socket = await open_gateway(fleet, tmp_path)
        socket.send("work", step={"do": "move", "to": {"gantry.x": 300}, "speed": 0.1})
        await socket.wait_for(lambda: (socket.find_kind("work") or {}).get("state") == "running")
        await asyncio.sleep(0.5)
        socket.close()
        await asyncio.sleep(2.5)
        assert not fleet.controllers["gantry"].is_moving("X")
        jobs = await fleet.make_client().list_jobs(1)
        assert jobs.jobs[0].state == "cancelled"

    run_with_gateway(main)


def test_a_one_step_job_reports_progress_and_end(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        _, socket = await open_gateway(fleet, tmp_path)
        for step, state in (
            ({"do": "move", "to": {"gantry.x": 3}}, "failed"),
            ({"do": "enable", "axes": ["gantry"]}, "done"),
        ):
            number = socket.send("work", step=step)
            async with asyncio.timeout(30):
                while (work := socket.find_kind("work")) is None or (work["id"], work["state"]) != (number, state):
                    await asyncio.sleep(0.1)
                    socket.send("alive")
            assert bool(work["reason"]) == (state == "failed")
        for step in ({"do": "scan"}, {"do": "dwell", "duration": "1s"}, 7, {"do": "home", "axes": 3}):
            assert (await socket.ask("work", step=step))["refused"]["code"] == "bad-request"

    run_with_gateway(main)


def test_two_operators_want_one_axis(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        gateway, first = await open_gateway(fleet, tmp_path)
        second = await gateway.connect()
        await begin_jog(fleet, first, 0.2)
        assert (await second.ask("acquire", axes=["gantry.x"]))["refused"]["code"] == "leased"
        assert (await second.ask("jog", axis="gantry.x", velocity=5))["refused"]["code"] == "not-leased"
        assert "gantry" in str(first.state["leases"])
        first.send("end-jog")
        await first.ask("release")
        assert "ok" in await second.ask("acquire", axes=["gantry.x"])

    run_with_gateway(main)


@pytest.mark.parametrize("what", ["stop", "estop"])
@pytest.mark.parametrize("by", ["socket", "post"])
def test_a_stop_needs_no_coordinator_and_is_shown_on_every_page(tmp_path: Path, what: str, by: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        gateway, socket = await open_gateway(fleet, tmp_path)
        other = await gateway.connect()
        await begin_jog(fleet, socket, 0.2)
        fleet.kill("coordinator/first")
        asked_ns = fleet.clock.now_ns()
        if by == "socket":
            other.send(what)
        else:
            await gateway.post(f"/v1/{what}", {})
        assert await find_end_ns(fleet) - asked_ns < RAMP_NS
        for each in (socket, other):
            stopped = await each.wait_for(lambda each=each: each.find_kind("stopped"))
            assert (stopped["what"], stopped["by"]) == (what, "operator@127.0.0.1")
            assert stopped["answers"]["gantry"] is None
        assert any(f"{what} by operator@127.0.0.1" in line for line in gateway.lines)
        if what == "estop":
            await asyncio.sleep(0.5)
            assert socket.state["controllers"]["gantry"]["estop"]["actor"] == "operator@127.0.0.1"

    run_with_gateway(main)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"id": 1}', '{"do": 5}', '{"do": "alive", "x": "' + "y" * 70_000 + '"}', "[" * 100_000]
)
def test_a_frame_that_is_none_ends_the_socket_and_no_other(tmp_path: Path, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway, socket = await open_gateway(fleet, tmp_path)
        other = await gateway.connect()
        socket.send_text(text)
        await socket.wait_for(lambda: socket.closed)
        assert socket.closed == 1008
        assert (await other.ask("stop"))["ok"]["answers"] == {"gantry": None, "stage": None}

    run_with_gateway(main)


@pytest.mark.parametrize(
    "frame",
    [
        {"do": "jog"},
        {"do": "jog", "axis": "gantry.x", "velocity": 0},
        {"do": "jog", "axis": "gantry.x", "velocity": "fast"},
        {"do": "jog", "axis": "gantry.x", "velocity": 1e999},
        {"do": "acquire", "axes": []},
        {"do": "acquire", "axes": "gantry.x"},
        {"do": "acquire", "axes": [1]},
        {"do": "acquire", "axes": ["nothing.x"]},
        {"do": "renew"},
        {"do": "fly"},
        {"do": "work"},
    ],
)
def test_a_frame_with_wrong_values_is_refused_in_words(tmp_path: Path, frame: dict[str, Any]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        _, socket = await open_gateway(fleet, tmp_path)
        socket.send_text(json.dumps({**frame, "id": 77}))
        answer = await socket.wait_for(lambda: socket.find(answer=77))
        assert answer["refused"]["text"] and answer["refused"]["remedy"]
        assert socket.closed is None

    run_with_gateway(main)


def test_a_renewal_changes_the_speed_of_a_jog(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        _, socket = await open_gateway(fleet, tmp_path)
        await outcome(fleet, PREPARE)
        await begin_jog(fleet, socket)
        for _ in range(8):
            await asyncio.sleep(0.1)
            assert "ok" in await socket.ask("renew", velocity=5)
        assert socket.state["controllers"]["gantry"]["axes"]["x"]["velocity"] == pytest.approx(5, abs=0.5)
        for velocity in (0, "fast", True, None, float("inf")):
            answer = await socket.ask("renew", velocity=velocity)
            assert answer["refused"]["code"] == "bad-request" and "end-jog" in answer["refused"]["remedy"]

    run_with_gateway(main)


def test_a_renewal_at_another_speed_moves_nothing_after_a_stop(tmp_path: Path) -> None:
    """A stick of a gamepad that stays deflected sends new speeds: none of them may begin what a stop has ended."""

    async def main(fleet: VirtualFleet) -> None:
        gateway, socket = await open_gateway(fleet, tmp_path)
        await outcome(fleet, PREPARE)
        await begin_jog(fleet, socket)
        other = await gateway.connect()
        assert "ok" in await other.ask("stop")
        await find_end_ns(fleet)
        for velocity in (6, 7):
            await socket.ask("renew", velocity=velocity)
            await asyncio.sleep(0.1)
            assert not fleet.controllers["gantry"].is_moving("X")
        assert socket.find_kind("jog")["refused"]["code"] in ("not-jogging", "not-leased")
        assert (await socket.ask("renew", velocity=8))["refused"]["code"] == "not-jogging"

    run_with_gateway(main)


def test_too_many_frames_end_a_socket(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        _, socket = await open_gateway(fleet, tmp_path)
        for _ in range(300):
            socket.send("alive")
        await socket.wait_for(lambda: socket.closed)
        assert socket.closed == 1008

    run_with_gateway(main)


def test_a_running_job_shows_its_targets_members_and_last_motion(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        gateway, socket = await open_gateway(fleet, tmp_path)
        steps = [
            {"do": "move", "to": {"gantry.x": 20}},
            {"do": "move", "to": {"gantry.x": "5 cm"}, "by": {"stage.u": 1}, "speed": 0.05},
        ]
        job = {"schema": "tutti.job/1", "name": "two", "steps": steps}
        job_id = (await gateway.post("/v1/submit", {"job": job})).json["job_id"]
        axes = {name: each["axes"] for name, each in socket.state["controllers"].items()}
        before = axes["stage"]["u"]["commanded"]

        def find_target() -> bool:
            return socket.state["controllers"]["gantry"]["axes"]["x"].get("target") == 50.0

        await socket.wait_for(find_target)
        assert socket.state["controllers"]["stage"]["axes"]["u"]["target"] == pytest.approx(before + 1)
        await asyncio.sleep(0.7)
        assert socket.state["members"][job_id]["members"] == {"gantry": "moving", "stage": "moving"}
        shown = (await gateway.get(f"/v1/jobs/{job_id}")).json
        assert shown["report"] is None and shown["last_motion"]["index"] == 0
        assert shown["last_motion"]["members"]["gantry"]["evidence"]["x"]["start"]
        await fleet.make_client().wait_for_job(job_id)
        await asyncio.sleep(0.3)
        assert "target" not in socket.state["controllers"]["gantry"]["axes"]["x"]

    run_with_gateway(main)
