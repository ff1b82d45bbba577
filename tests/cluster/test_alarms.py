"""Alarms of a fleet at work: raised, kept, acknowledged and shelved; nothing moves or stops because of them."""

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.bus.base import Priority
from orchestrator.bus.states.frame import FrameHeader, encode_frame
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.alarms.fleet_sources import FleetAlarms
from orchestrator.coordinator.alarms.motion_sources import MotionAlarms
from orchestrator.coordinator.leadership.environment import CommandResult
from orchestrator.coordinator.statistics.availability import AvailabilityClock
from orchestrator.coordinator.statistics.collector import StatisticsCollector
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.alarms import OPEN_BUS, AlarmRecord, AlarmRequest
from orchestrator.monitor.fleet_view import LiveView
from orchestrator.monitor.open_bus import find_openness
from orchestrator.runtime.doctor.router import list_alarms
from orchestrator.runtime.virtual.fleet import VirtualFleet

QUICK = {
    "disconnected": {"for": "2 s", "return_after": "1 s"},
    "link_errors": {"limit": 3, "within": "30 s"},
    "second_leader": {"return_after": "10 s"},
}


def fleet_with(**sections: object) -> Fleet:
    return Fleet.model_validate(demo_fleet().to_plain() | {"alarms": QUICK} | sections)


async def wait_s(fleet: VirtualFleet, seconds: float) -> None:
    await sleep_ns(fleet.clock, round(seconds * NS_PER_S))


async def states(fleet: VirtualFleet, *, normal: bool = False) -> dict[str, str]:
    """The state of each alarm, by id; in brackets if it is set aside."""
    found = await fleet.make_client().list_alarms(normal=normal)
    return {each.id: f"({each.state})" if each.is_suppressed else each.state for each in found}


class Commands:
    """A scripted command: what it was run with, and how it ends, by alarm; None: it hangs."""

    def __init__(self, fleet: VirtualFleet, **codes: list[int | None]) -> None:
        self.codes = codes
        self.fleet = fleet
        self.runs: list[tuple[float, str, str]] = []
        fleet.run_command = self.run

    async def run(
        self, words: Sequence[str], text: bytes, variables: Mapping[str, str], timeout_ns: int
    ) -> CommandResult:
        record = AlarmRecord.model_validate_json(text)
        assert words == ["page"] and variables["TUTTI_ALARM_ID"] == record.id
        codes = self.codes.get(record.kind, [])
        code = codes.pop(0) if codes else 0
        if code is None:
            await sleep_ns(self.fleet.clock, timeout_ns)
        self.runs.append((self.fleet.clock.now_ns() / NS_PER_S, record.id, record.change))
        return CommandResult(code, "" if code == 0 else "no line")

    @property
    def alarms(self) -> list[str]:
        return [each for _, each, _ in self.runs]


async def restart(fleet: VirtualFleet, *, kill: bool = True) -> None:
    """End the coordinator and start another one on its journal."""
    if kill:
        fleet.kill("coordinator/first")
    await wait_s(fleet, 1)
    fleet.start_coordinator("first")
    await wait_s(fleet, 2)


def test_disconnected_and_the_fault_behind_it_are_two_and_neither_flaps() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        assert await states(fleet) == {}
        fleet.wires["stage"].cut = True
        await wait_s(fleet, 1.5)
        assert "disconnected-stage" not in await states(fleet)  # not before it has lasted
        await wait_s(fleet, 5)
        assert await states(fleet) == {
            "disconnected-stage": "unacknowledged",
            "fault-no-answer-stage": "unacknowledged",
        }
        changed_ones = await client.acknowledge_alarms("disconnected-stage")
        assert [(each.id, each.state, each.acknowledged_by) for each in changed_ones] == [
            ("disconnected-stage", "acknowledged", "client")
        ]
        fleet.wires["stage"].cut = False
        await wait_s(fleet, 12)
        # One was acknowledged, and is over; the other one waits for that.
        assert await states(fleet) == {"fault-no-answer-stage": "returned"}
        assert (await states(fleet, normal=True))["disconnected-stage"] == "normal"
        await client.acknowledge_alarms()
        assert await states(fleet) == {}
        history = [(each.id, each.state) for each in await client.list_alarm_history()]
        assert history[0] == ("fault-no-answer-stage", "normal") and history[-1][1] == "unacknowledged"
        assert len({each.change for each in await client.list_alarm_history()}) == len(history) == 6

    run_fleet(main, fleet_with())


def test_alarms_survive_a_kill_of_the_coordinator_and_late_readers_find_them() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        fleet.wires["stage"].cut = True
        await wait_s(fleet, 5)
        await client.acknowledge_alarms("fault-no-answer-stage")
        shelved = await client.shelve_alarm("disconnected-stage", 3600, "its cable is being changed")
        assert (shelved.shelved_by, shelved.is_open) == ("client", False)
        await restart(fleet)
        assert await states(fleet) == {
            "disconnected-stage": "(unacknowledged)",
            "fault-no-answer-stage": "acknowledged",
        }
        found = await client.bus.request_all(client.keys.alarm(), b"", 1.0)
        records = [AlarmRecord.model_validate_json(each) for each in found.values()]
        assert {each.id: each.shelved_why for each in records} == {
            "disconnected-stage": "its cable is being changed",
            "fault-no-answer-stage": "",
        }
        # What ends while no coordinator is there is noticed too.
        fleet.kill("coordinator/first")
        fleet.wires["stage"].cut = False
        await wait_s(fleet, 12)
        fleet.start_coordinator("first")
        await wait_s(fleet, 12)
        assert await states(fleet) == {"disconnected-stage": "(returned)"}

    run_fleet(main, fleet_with())


def test_a_shelved_alarm_comes_back_at_its_time_and_at_once_when_that_is_ended() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        fleet.wires["stage"].cut = True
        await wait_s(fleet, 5)
        await client.acknowledge_alarms()
        await client.shelve_alarm("disconnected-stage", 5)
        assert (await states(fleet))["disconnected-stage"] == "(acknowledged)"
        await wait_s(fleet, 7)
        assert (await states(fleet))["disconnected-stage"] == "unacknowledged"
        await client.shelve_alarm("disconnected-stage", 86_400)
        assert (await client.unshelve_alarm("disconnected-stage")).state == "unacknowledged"
        with pytest.raises(Refusal, match="there is no alarm disconnected-stag") as refused:
            await client.unshelve_alarm("disconnected-stag")
        assert refused.value.code == "unknown-alarm" and "did you mean disconnected-stage?" in refused.value.remedy

    run_fleet(main, fleet_with())


def test_alarms_of_reserved_axes_are_out_of_service_and_come_back_by_themselves() -> None:
    async def main(fleet: VirtualFleet) -> None:
        commands = Commands(fleet)
        client = fleet.make_client()
        _, holder = await client.reserve_axes(["stage"], 3600, "new belt")
        fleet.wires["stage"].cut = fleet.wires["gantry"].cut = True
        await wait_s(fleet, 6)
        found = {each.id: each for each in await client.list_alarms()}
        assert found["disconnected-stage"].out_of_service == "reserved by client: new belt"
        assert found["disconnected-gantry"].is_open
        assert "disconnected-gantry" in commands.alarms and "disconnected-stage" not in commands.alarms
        await client.release_axes(holder)
        await wait_s(fleet, 3)
        assert (await states(fleet))["disconnected-stage"] == "unacknowledged"
        assert commands.alarms.count("disconnected-stage") == 1

    run_fleet(main, fleet_with(notify={"command": ["page"]}))


def test_an_estop_is_one_alarm_and_alarms_move_and_stop_nothing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        job_id = await client.submit(job("[{do: move, to: {gantry.x: 100}, speed: 0.1}]"))
        await wait_s(fleet, 1)
        for number in range(30):
            request = AlarmRequest(kind="vacuum", subject=f"pump {number}", text="no vacuum", active=True)
            client.bus.put(client.keys.alarm_request("gateway", "g1"), request.to_json(), Priority.EVENT)
        assert (await client.wait_for_job(job_id)).state == "done"
        found = await client.list_alarms()
        assert len(found) == 20 and {each.source for each in found} == {"gateway/g1"}  # of one process, no more
        await client.estop("hand in the machine")
        await wait_s(fleet, 2)
        alarm = next(each for each in await client.list_alarms() if each.kind == "estop")
        assert (alarm.subject, alarm.priority, alarm.text) == ("fleet", "high", "e-stop by client: hand in the machine")
        await client.reset()
        await wait_s(fleet, 2)
        assert (await states(fleet))["estop-fleet"] == "returned"
        # Not repeated by their process, they are over.
        await wait_s(fleet, 130)
        assert {each.state for each in await client.list_alarms()} == {"returned"}

    run_fleet(main, fleet_with())


def test_requests_of_others_are_checked_and_name_their_source() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        key = client.keys.alarm_request("recorder", "r1")
        client.bus.put(key, b"no json", Priority.EVENT)
        client.bus.put(key, b'{"kind": "recorder", "subject": "disk", "text": "full"}', Priority.EVENT)
        request = AlarmRequest(kind="recorder", subject="disk", text="full", action="free space", active=True)
        client.bus.put(key, request.to_json(), Priority.EVENT)
        await wait_s(fleet, 1)
        (alarm,) = await client.list_alarms()
        assert (alarm.kind, alarm.source, alarm.priority, alarm.action) == (
            "recorder", "recorder/r1", "medium", "free space",
        )  # fmt: skip
        left_out = [line for line in fleet.lines if "an alarm of recorder/r1 is left out" in line]
        assert len(left_out) == 2 and "active: Field required" in left_out[1]
        over = request.model_copy(update={"active": False})
        client.bus.put(key, over.to_json(), Priority.EVENT)
        await wait_s(fleet, 7)
        assert set((await states(fleet)).values()) == {"returned"}

    run_fleet(main, fleet_with())


def test_an_open_bus_is_named_by_views_and_the_doctor_also_when_it_was_set_aside() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        view, words = LiveView(client.keys, lambda: 0.0), "INSECURE: the bus at tcp/0.0.0.0:7447 has no TLS"
        said: list[str | None] = []
        request = AlarmRequest(kind=OPEN_BUS, subject="bus", text=words, priority="high", active=True)
        async with client.follow_all(*view.key_expressions) as followed:
            samples = followed.queue
            client.bus.put(client.keys.alarm_request("router", "main"), request.to_json(), Priority.EVENT)
            await wait_s(fleet, 1)
            (alarm,) = await client.acknowledge_alarms()
            await client.shelve_alarm(alarm.id, 3600)
            await wait_s(fleet, 1)
            while not samples.empty():
                said.append(view.take_sample(samples.get_nowait()))
        assert said.count(words) == 1 and view.openness == words
        assert find_openness("tcp/127.0.0.1:7447", await list_alarms(client.bus)) == words
        await wait_s(fleet, 130)  # the router is gone
        assert find_openness("tcp/127.0.0.1:7447", await list_alarms(client.bus)) == ""
        assert find_openness("tcp/192.0.2.1:7447", []).startswith("INSECURE")

    run_fleet(main, fleet_with())


def test_a_full_disk_is_an_alarm_that_needs_no_disk() -> None:
    async def main(fleet: VirtualFleet) -> None:
        commands = Commands(fleet)
        client = fleet.make_client()
        fleet.coordinator_disk.full = True
        await wait_s(fleet, 65)
        fleet.wires["stage"].cut = True
        await wait_s(fleet, 6)
        found = await states(fleet)
        assert found["disk-space"] == found["disk-journal"] == found["disconnected-stage"] == "unacknowledged"
        assert {"disk-space", "disk-journal", "disconnected-stage"} <= set(commands.alarms)
        with pytest.raises(Refusal) as refused:
            await client.acknowledge_alarms("disk-space")
        assert refused.value.code == "journal" and (await states(fleet))["disk-space"] == "unacknowledged"
        fleet.coordinator_disk.full = False
        await wait_s(fleet, 75)
        assert {(await states(fleet))[each] for each in ("disk-space", "disk-journal")} == {"returned"}
        await restart(fleet)
        assert "disconnected-stage" in await states(fleet)
        # Each notice was run once: they were deleted when the journal could be written again.
        assert len(commands.alarms) == len(set(commands.alarms))

    run_fleet(main, fleet_with(notify={"command": ["page"]}))


def test_a_command_that_fails_or_hangs_is_run_again_and_survives_a_restart() -> None:
    async def main(fleet: VirtualFleet) -> None:
        commands = Commands(fleet, fault=[1, None, 1, 1, 1])
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        fleet.wires["stage"].cut = True
        await wait_s(fleet, 45)
        tries = [at for at, alarm, _ in commands.runs if alarm == "fault-no-answer-stage"]
        other = [at for at, alarm, _ in commands.runs if alarm == "disconnected-stage"]
        assert len(tries) >= 3 and len(other) == 1, commands.runs
        pauses = [round(after - before) for before, after in pairwise(tries)]
        assert pauses[:2] == [2 + 5, 4]  # one that hangs is killed after its timeout
        # It has failed again and again: an alarm, for which it is not run.
        assert (await states(fleet))["notify-command"] in ("unacknowledged", "returned")
        assert "notify-command" not in commands.alarms
        commands.codes.clear()
        await restart(fleet)
        await wait_s(fleet, 10)
        assert len({change for _, alarm, change in commands.runs if alarm == "fault-no-answer-stage"}) == 1
        count = len(commands.runs)
        await restart(fleet)
        await wait_s(fleet, 10)
        assert len(commands.runs) == count
        await client.close()

    run_fleet(main, fleet_with(notify={"command": ["page"], "timeout": "5 s", "pause": "2 s"}))


def test_links_that_break_often_and_forged_leaders_are_alarms() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        for _ in range(3):
            for link in list(fleet.wires["gantry"].links):
                link._mark_closed()
            await wait_s(fleet, 4)
        assert (await states(fleet))["link-errors-gantry"] == "unacknowledged"
        assert "disconnected-gantry" not in await states(fleet)
        leader = fleet.coordinators["first"][1].leadership
        forged = leader.make_heartbeat().model_copy(update={"coordinator": "f" * 32, "epoch": 99})
        client.bus.put(client.keys.leader, forged.to_json(), Priority.EVENT)
        await wait_s(fleet, 2)
        alarm = next(each for each in await client.list_alarms() if each.kind == "second-leader")
        assert "coordinator ffffffff with epoch 99" in alarm.text
        await wait_s(fleet, 40)
        assert set((await states(fleet)).values()) == {"returned"}

    run_fleet(main, fleet_with())


def test_states_of_controllers_that_the_fleet_does_not_have_are_one_alarm_and_nothing_else() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        real_state = (await client.status())["gantry"]
        for number in range(3):
            forged_state = real_state.model_copy(update={"controller": f"ghost{number}", "mode": "moving"})
            header = FrameHeader(
                host="ghosts",
                instance="i",
                number=number + 1,
                utc=real_state.utc,
                lines=[f"ghost{number}/state"],
                states={},
            )
            client.bus.put(client.keys.host_states("ghosts"), encode_frame(header, [forged_state.to_json()]))
        await wait_s(fleet, 2)
        (alarm,) = [alarm for alarm in await client.list_alarms() if alarm.kind == "unknown-controller"]
        assert alarm.text == "3 controllers publish states that the fleet file does not have; the last one is ghost2"
        assert "ghost0" not in await client.status()
        await client.wait_for_job(await client.submit(PREPARE))
        await wait_s(fleet, 15)
        assert (await states(fleet))["unknown-controller-fleet"] == "returned"

    run_fleet(main, fleet_with())


def test_ten_steps_near_their_budget_raise_one_alarm() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        moves = [{"do": "move", "to": {"gantry.x": number, "stage.u": number}} for number in (3, 2, 3, 2)]
        await outcome(fleet, job(json.dumps(moves)))
        (alarm,) = await fleet.make_client().list_alarms()
        assert (alarm.id, alarm.kind, alarm.subject) == ("budget-gantry_stage", "budget", "gantry+stage")
        assert alarm.text.startswith("3 steps in succession of gantry+stage have used more than 1% of")

    run_fleet(main, fleet_with(alarms={"budget": {"limit": 0.01, "steps": 3}}))


def test_rules_follow_a_reload_and_the_command_does_not() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        with pytest.raises(Refusal, match="notify would change") as refused:
            await client.reload_fleet(fleet_with(notify={"command": ["/tmp/mine"]}))
        assert refused.value.code == "other-command"
        fleet.wires["stage"].cut = True
        await wait_s(fleet, 6)
        assert "disconnected-stage" in await states(fleet)
        await client.reload_fleet(fleet_with(alarms={"disconnected": {"enabled": False}}))
        await wait_s(fleet, 7)
        assert await states(fleet) == {"disconnected-stage": "returned", "fault-no-answer-stage": "unacknowledged"}

    run_fleet(main, fleet_with())


def test_a_defect_of_alarms_or_statistics_is_logged_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ValueError("a defect")

    for owner, name in (
        (FleetAlarms, "take_state"),
        (FleetAlarms, "tick"),
        (MotionAlarms, "take_motion"),
        (StatisticsCollector, "_count"),
        (AvailabilityClock, "tick"),
    ):
        monkeypatch.setattr(owner, name, fail)

    async def main(fleet: VirtualFleet) -> None:
        moved = job("[{do: move, to: {gantry.x: 10, stage.u: 2}}]")
        assert (await outcome(fleet, PREPARE, moved)).state == "done"
        assert not fleet.coordinators["first"][1].broken.is_set()
        assert any("a defect of the coordinator: ValueError('a defect')" in line for line in fleet.lines)

    run_fleet(main)


def test_an_acknowledged_estop_stays_so_over_a_restart_and_a_takeover_ends_the_notices_of_the_old_leader() -> None:
    async def main(fleet: VirtualFleet) -> None:
        commands = Commands(fleet)
        client = fleet.make_client()
        await client.estop("hand in the machine")
        await wait_s(fleet, 2)
        await client.acknowledge_alarms()
        fleet.start_coordinator("second", take_over=True)
        await wait_s(fleet, 15)
        assert set((await states(fleet)).values()) == {"acknowledged"}
        assert {each.id: each.count for each in await client.list_alarms()}["estop-fleet"] == 1
        await client.reset()
        await wait_s(fleet, 2)
        fleet.wires["stage"].cut = True
        await wait_s(fleet, 10)
        assert (await states(fleet, normal=True))["estop-fleet"] == "normal"
        assert len(commands.alarms) == len(set(commands.alarms)) and "disconnected-stage" in commands.alarms

    run_fleet(main, fleet_with(notify={"command": ["page"]}))
