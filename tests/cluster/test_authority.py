"""Senders that no controller was adopted by: they keep no axis moving, stop no watchdog, and depose no coordinator."""

# pyright: reportPrivateUsage=false

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from adapters.controller.slots.participant import StepParticipant
from adapters.controller.state.store import FileStore
from adapters.host.leader_watch import LeaderWatch
from orchestrator.bus.base import BusSample, Priority
from orchestrator.bus.estop import put_estop
from orchestrator.bus.latch import FileLatchStore, LatchKeeper
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import JobSubmitted
from orchestrator.model.messages import (
    HEARTBEAT_NS,
    MAX_EPOCH_STEP,
    AcceptEpoch,
    AdoptedReply,
    AdoptRequest,
    CommitRequest,
    EstopMessage,
    LeaderHeartbeat,
    RefusalDetails,
    Reply,
    StartAtOnceRequest,
    StartedReply,
)
from orchestrator.model.state import EstopLatch
from orchestrator.runtime.virtual.fleet import VirtualFleet

LONG = job("[{do: move, to: {gantry.x: 390, stage.u: 45}, speed: 0.05}]")
COORDINATOR_LOST_NS = 500 * NS_PER_MS  # as documented, and not as the code has it
RAMPS_NS = 300 * NS_PER_MS


def forge(fleet: VirtualFleet, **changes: Any) -> LeaderHeartbeat:
    """A heartbeat like that of the present leader."""
    (_, coordinator), *_ = fleet.coordinators.values()
    return coordinator.leadership.make_heartbeat().model_copy(update=changes)


async def send(fleet: VirtualFleet, *heartbeats: LeaderHeartbeat) -> None:
    client = fleet.make_client(f"forger{fleet.clock.now_ns()}")
    for each in heartbeats:
        client.bus.put(fleet.keys.leader, each.to_json(), Priority.EVENT)
    await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    "changes",
    [
        {"epoch": 2**53 - 1, "coordinator": "forged"},
        {"epoch": 2, "coordinator": "forged", "scale_id": "other", "origin_host_ns": 5},
        {"seq": 2**53 - 1},
        {"scale_id": "other", "origin_host_ns": 5},
    ],
    ids=["far-epoch", "next-epoch", "far-seq", "other-scale"],
)
def test_one_forged_heartbeat_changes_nothing(changes: dict[str, Any]) -> None:
    """The leader leads on; when it is killed in a move, the axes stop as declared."""

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        await send(fleet, forge(fleet, **changes))
        await asyncio.sleep(2.0)
        assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 5, stage.u: 5}}]"))).state == "done"
        await fleet.make_client().submit(LONG)
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        await send(fleet, forge(fleet, **changes))
        killed_ns = fleet.clock.now_ns()
        fleet.kill("coordinator/first")
        await asyncio.sleep(3.0)
        for name in ("gantry", "stage"):
            last = fleet.controllers[name].commanded_motions[-1]
            assert last.end_ns is not None, name
            assert last.end_ns - killed_ns < COORDINATOR_LOST_NS + HEARTBEAT_NS + RAMPS_NS, name

    run_fleet(main)


def test_a_coordinator_that_does_not_answer_is_an_alarm() -> None:
    async def main(fleet: VirtualFleet) -> None:
        for seq in range(30):
            await send(fleet, forge(fleet, epoch=5, coordinator="forged", seq=seq))
        alarms = [line for line in fleet.lines if "no such coordinator answers" in line]
        assert len(alarms) == 1
        assert (await outcome(fleet, PREPARE)).state == "done"

    run_fleet(main)


def test_a_coordinator_starts_beside_forged_heartbeats() -> None:
    async def main(fleet: VirtualFleet) -> None:
        beat = forge(fleet, coordinator="forged", epoch=3)

        async def send_on() -> None:
            for seq in range(200):
                await send(fleet, beat.model_copy(update={"seq": seq}))

        fleet.kill("coordinator/first")
        sending = asyncio.get_running_loop().create_task(send_on())
        fleet.start_coordinator("second")
        await asyncio.sleep(3.0)
        assert (await outcome(fleet, PREPARE)).state == "done"
        sending.cancel()

    run_fleet(main)


def test_an_adoption_with_a_far_epoch_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        for epoch, code in ((2 + MAX_EPOCH_STEP, "far-epoch"), (2**53 - 1, "far-epoch")):
            leader = forge(fleet, epoch=epoch, coordinator="forged")
            request = AdoptRequest(**client.request_fields(), epoch=epoch, coordinator="forged", leader=leader)
            payload = await client.bus.request(fleet.keys.command("gantry", "adopt"), request.to_json(), 1.0)
            refused = AdoptedReply.model_validate_json(payload).refused
            assert refused is not None and refused.code == code
        assert (await outcome(fleet, PREPARE)).state == "done"

    run_fleet(main)


def test_a_far_epoch_of_an_adapter_is_not_taken_over() -> None:
    journal = SqliteJournal(":memory:")
    assert journal.take_epoch(0) == 1
    assert journal.take_epoch(2**53 - 1) == 2
    assert journal.take_epoch(100) == 101
    journal.close()


def test_silence_counts_from_the_adoption_on() -> None:
    """Also when no heartbeat was ever received."""

    async def main(clock: VirtualClock) -> None:
        watch = LeaderWatch(clock)
        beat = LeaderHeartbeat(
            fleet="f", epoch=1, coordinator="c", seq=7, scale_id="s", kernel_id="k", origin_host_ns=0, utc=""
        )
        watch.follow("gantry", beat)
        await asyncio.sleep(0.4)
        assert watch.find_lost() == {}
        await asyncio.sleep(0.2)
        assert list(watch.find_lost()) == ["gantry"]
        assert watch.find_lost() == {}  # once
        assert watch.receive_heartbeat(beat.model_copy(update={"seq": 8}))
        assert not watch.receive_heartbeat(beat.model_copy(update={"seq": 8}))
        assert not watch.receive_heartbeat(beat.model_copy(update={"seq": 12}))
        assert watch.receive_heartbeat(beat.model_copy(update={"seq": 11}))
        await asyncio.sleep(1.0)
        assert list(watch.find_lost()) == ["gantry"]

    run_virtual(main)


def test_the_end_of_a_vital_task_ends_the_process() -> None:
    """The heartbeat died of an epoch that no message can carry, unreported, while jobs were still accepted."""

    async def main(fleet: VirtualFleet) -> None:
        (_, coordinator), *_ = fleet.coordinators.values()
        coordinator.leadership.epoch = 2**53
        await asyncio.sleep(0.2)
        assert coordinator.broken.is_set()
        assert any("a defect of the coordinator: " in line and "leadership.py" in line for line in fleet.lines)

    run_fleet(main)


def test_a_task_that_is_not_vital_is_reported() -> None:
    found: list[tuple[str, bool]] = []

    async def fail(text: str) -> None:
        raise RuntimeError(text)

    async def main(clock: VirtualClock) -> None:
        owner = TaskOwner(lambda error, vital: found.append((str(error), vital)))
        owner.spawn(fail("one"), vital=False)
        owner.spawn(fail("two"), vital=True)
        endless = owner.spawn(asyncio.sleep(1e6), vital=True)
        await sleep_ns(clock, NS_PER_MS)
        owner.cancel_all()
        await sleep_ns(clock, NS_PER_MS)
        assert endless.cancelled()

    run_virtual(main)
    assert found == [("one", False), ("two", True)]


def test_an_estop_while_the_only_host_restarts_is_latched_when_it_is_back() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        fleet.kill("host/local")
        await asyncio.sleep(0.1)
        await client.estop("nothing receives it but the coordinator", timeout_s=0.1)
        states = await fleet.wait_until(lambda states: len(states) == 2 and all(each.epoch for each in states.values()))
        assert {name: state.estop and state.estop.actor for name, state in states.items()} == {
            "gantry": "client",
            "stage": "client",
        }
        starts = {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()}
        await client.start_queue()
        waiting = await client.submit(job("[{do: enable, axes: [gantry]}, {do: home, axes: [gantry]}]"))
        await asyncio.sleep(2.0)
        assert {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()} == starts
        assert not any((await client.reset()).values())
        await client.start_queue()
        assert (await client.wait_for_job(waiting)).state == "done"
        # The reset has reached the keeper: a host that starts now is not latched.
        fleet.kill("host/local")
        states = await fleet.wait_until(lambda states: len(states) == 2 and all(each.epoch for each in states.values()))
        assert all(state.estop is None for state in states.values())

    run_fleet(main)


def test_an_estop_that_only_the_router_received_is_latched_when_the_fleet_is_back(tmp_path: Path) -> None:
    """Coordinator and adapter host are down, and only its process is on the bus."""

    async def main(clock: VirtualClock) -> None:
        fleet = VirtualFleet(demo_fleet(), clock, 1, guardian=False)
        router = fleet.net.join_process("router")
        await LatchKeeper(router, fleet.keys, clock.utc, FileLatchStore(tmp_path / "estop.json")).start("router")
        await fleet.start()
        client = fleet.make_client()
        fleet.kill("host/local")
        fleet.kill("coordinator/first")
        await asyncio.sleep(0.1)
        put_estop(client.bus, fleet.fleet.fleet, "e1", "client", "a test")
        await asyncio.sleep(0.1)
        fleet.start_host("local")
        fleet.start_coordinator("second")
        states = await fleet.wait_until(lambda states: all(each.epoch == 2 for each in states.values()))
        assert all(state.estop is not None and state.estop.event == "e1" for state in states.values())
        await client.start_queue()
        waiting = await client.submit(PREPARE)
        await asyncio.sleep(5.0)
        assert not any(unit.commanded_motions for unit in fleet.controllers.values())
        assert not any((await client.reset()).values())
        await client.start_queue()
        assert (await client.wait_for_job(waiting)).state == "done"
        assert FileLatchStore(tmp_path / "estop.json").load() is None

    run_virtual(main)


def test_a_coordinator_that_starts_has_the_latch_of_the_one_before() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        fleet.kill("host/local")
        await client.estop("test", timeout_s=0.1)
        fleet.kill("coordinator/first")
        fleet.start_coordinator("second")
        await asyncio.sleep(1.5)
        states = await fleet.wait_until(lambda states: len(states) == 2 and all(each.epoch for each in states.values()))
        assert all(state.estop is not None for state in states.values())

    run_fleet(main)


def test_a_stored_latch_that_cannot_be_read_counts_as_latched(tmp_path: Path) -> None:
    store = FileLatchStore(tmp_path / "estop.json")
    assert store.load() is None
    latch = EstopLatch(event="e", actor="a", reason="r", utc="")
    store.save(latch)
    assert FileLatchStore(tmp_path / "estop.json").load() == latch
    store.save(None)
    assert store.load() is None
    (tmp_path / "estop.json").write_bytes(b"\x00garbage")
    found = store.load()
    assert found is not None and "cannot be read" in found.reason


def test_a_host_whose_supervision_has_ended_is_not_sound() -> None:
    """Its guardian sees more than a running event loop."""

    async def main(clock: VirtualClock) -> None:
        fleet = VirtualFleet(demo_fleet(), clock, 1)
        await fleet.start()
        assert fleet.adapter_hosts["local"].is_sound
        unit = fleet.adapter_hosts["local"].supervisors["gantry"]
        keeping: Any = unit._keeping
        keeping.cancel()
        await sleep_ns(clock, NS_PER_MS)
        assert not fleet.adapter_hosts["local"].is_sound

    run_virtual(main)


def test_a_second_queryable_on_a_controller_is_an_alarm() -> None:
    async def main(fleet: VirtualFleet) -> None:
        async def forge_reply(_: BusSample) -> bytes:
            return b'{"refused": null}'

        await fleet.make_client("forger").bus.serve(fleet.keys.command("gantry"), forge_reply)
        client = fleet.make_client()
        for _ in range(3):
            await client.submit(job("[{do: output, output: gantry.lamp, value: true}]"))
            await asyncio.sleep(0.5)
        alarms = [line for line in fleet.lines if "two processes answer on " in line]
        assert alarms and len(alarms) == len(set(alarms))
        assert any("ctl/gantry/cmd/" in line for line in alarms)

    run_fleet(main)


async def serve_forged(fleet: VirtualFleet, answer: Callable[[BusSample], bytes], *expressions: str) -> list[str]:
    """Serve `expressions` from another process that answers at once; return the keys that were requested."""
    bus, asked = fleet.make_client("forger").bus, list[str]()

    async def forge(sample: BusSample) -> bytes:
        asked.append(sample.key)
        return answer(sample)

    for each in expressions:
        await bus.serve(each, forge)
    return asked


def forge_promises(sample: BusSample) -> bytes:
    """An "ok" to every request, single or batched."""
    found = json.loads(sample.payload)
    if "requests" in found:
        return json.dumps({"replies": dict.fromkeys(found["requests"], '{"refused": null}')}).encode()
    return b'{"refused": null}'


def test_a_forged_start_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its adapter refuses to start, slower than another process says that it has started."""

    async def refuse(unit: StepParticipant, request: StartAtOnceRequest) -> StartedReply:
        await asyncio.sleep(0.05)
        raise Refusal("not-safe", "this one will not move", "")

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        asked = await serve_forged(fleet, forge_promises, fleet.keys.command("gantry", "start-at-once"))
        with monkeypatch.context() as patched:
            patched.setattr(StepParticipant, "start_at_once", refuse)
            report = await outcome(fleet, job("[{do: move, to: {gantry.x: 5}}]"))
        assert asked
        assert report.state == "failed" and "this one will not move" in report.reason
        assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 5}}]"))).state == "done"

    run_fleet(main)


@pytest.mark.parametrize("axes", ["gantry.x: 5, stage.u: 5", "gantry.x: 5"], ids=["batched", "single"])
def test_a_forged_promise_does_not_count(axes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its adapter refuses to commit, slower than another process says that it does."""

    async def refuse(unit: StepParticipant, request: CommitRequest) -> Reply:
        await asyncio.sleep(0.05)
        return Reply(refused=RefusalDetails(code="not-safe", text="this one will not move"))

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        commits = (fleet.keys.command("gantry", "commit"), fleet.keys.batch_command("local", "commit"))
        asked = await serve_forged(fleet, forge_promises, *commits)
        with monkeypatch.context() as patched:
            patched.setattr(StepParticipant, "commit_step", refuse)
            report = await outcome(fleet, job(f"[{{do: move, to: {{{axes}}}, start: agreed}}]"))
        assert asked
        assert report.state == "failed" and "this one will not move" in report.reason
        assert any("two processes answer on " in line for line in fleet.lines)
        # A promise of its adapter counts beside the forged one.
        assert (await outcome(fleet, job(f"[{{do: move, to: {{{axes}}}}}]"))).state == "done"

    run_fleet(main)


def test_a_forged_acceptance_of_a_job_does_not_count() -> None:
    async def main(fleet: VirtualFleet) -> None:
        forged = JobSubmitted(job_id="forged").to_json()
        asked = await serve_forged(fleet, lambda _: forged, fleet.keys.service("submit"))
        client = fleet.make_client()
        for _ in range(20):
            assert (await client.submit(PREPARE)).id != "forged"
        with pytest.raises(Refusal) as refused:
            await client.submit(job("[{do: move, to: {gantry.x: 99999}}]"))
        assert refused.value.code != "no-coordinator"
        assert len(asked) == 21
        # Without a leader the forged answer is not an acceptance, either.
        fleet.kill("coordinator/first")
        await asyncio.sleep(0.1)
        for each in (client, fleet.make_client()):
            with pytest.raises(Refusal) as refused:
                await each.submit(PREPARE)
            assert refused.value.code == "no-coordinator"
        # A client follows the next coordinator.
        fleet.start_coordinator("second")
        await asyncio.sleep(3.0)
        assert (await client.submit(PREPARE)).id != "forged"

    run_fleet(main)


def test_nothing_is_submitted_while_two_processes_say_that_they_lead() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await serve_forged(fleet, lambda _: forge(fleet).to_json(), fleet.keys.leader_answer("forged"))
        with pytest.raises(Refusal) as refused:
            await fleet.make_client().submit(PREPARE)
        assert refused.value.code == "several-servers"

    run_fleet(main)


def test_a_controller_with_two_adapters_is_not_adopted() -> None:
    """Which of them drives it cannot be known; the alarm is given once."""

    async def main(fleet: VirtualFleet) -> None:
        await serve_forged(fleet, lambda _: b"{}", fleet.keys.state("gantry"))
        fleet.kill("host/local")
        await asyncio.sleep(10.0)
        alarms = [line for line in fleet.lines if f"two processes answer on {fleet.keys.state('gantry')}" in line]
        assert len(alarms) == 1
        assert fleet.adapter_hosts["local"]._leaders._adopters.keys() == {"stage"}
        # A job for it waits, with the reason.
        await fleet.make_client().start_queue()
        waiting = await fleet.make_client().submit(job("[{do: enable, axes: [gantry]}]"))
        await asyncio.sleep(1.0)
        (entry,) = (await fleet.make_client().list_jobs()).jobs
        assert (entry.id, entry.state) == (waiting, "queued")
        assert "gantry is not adopted by this coordinator yet" in entry.reason
        # What the other process answers keeps no client from the states of the adapters.
        assert "stage" in await fleet.make_client().status()

    run_fleet(main)


@pytest.mark.parametrize("damaged", ["adapter", "journal"])
def test_a_far_epoch_is_repaired_by_the_command_that_the_fleet_names(damaged: str) -> None:
    """Without it every coordinator would be refused for ever."""

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        for host in fleet.fleet.hosts:
            fleet.kill(f"host/{host}")
        fleet.kill("coordinator/first")
        if damaged == "adapter":
            disk = fleet.host_disks[fleet.fleet.controllers["gantry"].host]
            store = FileStore(Path("gantry.json"), disk.access_files())
            store.save(store.load().model_copy(update={"epoch": 2**40, "coordinator": "none"}))
        else:
            fleet.journal.take_epoch(0)
            fleet.journal.set_epoch(2**40)
        fleet.start_coordinator("second")
        await asyncio.sleep(3.0)
        await client.start_queue()
        job_id = await client.submit(PREPARE)
        await asyncio.sleep(2.0)
        entry = (await client.show_job(job_id)).entry
        assert entry is not None and entry.state == "queued" and "`tutti repair epoch`" in entry.reason
        repaired = await client.repair_epoch()
        assert "gantry" in repaired
        assert (await client.wait_for_job(job_id)).state == "done"
        assert await client.repair_epoch() == []

    run_fleet(main)


def test_an_epoch_is_repaired_at_rest_only() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        await client.submit(LONG)
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        with pytest.raises(Refusal, match="moves"):
            await client.repair_epoch()
        request = AcceptEpoch(**client.request_fields(), epoch=1, coordinator="forged")
        payload = await client.bus.request(fleet.keys.command("gantry", "accept-epoch"), request.to_json(), 1.0)
        refused = Reply.model_validate_json(payload).refused
        assert refused is not None and refused.code in ("busy", "moving")

    run_fleet(main)


@pytest.mark.parametrize("silent_s", [0.05, 0.3, 1.2])
def test_an_estop_that_a_host_did_not_receive_is_latched_when_it_receives_again(silent_s: float) -> None:
    """The bus forwards nothing to the host while the e-stop is sent; the axes that move stop, and nothing moves again
    without a reset, which holds although the coordinator receives it a moment later."""

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        await client.submit(LONG)
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        host = fleet.find_process(f"host/{fleet.fleet.controllers['gantry'].host}").name
        fleet.net.block_way(None, host)
        await asyncio.sleep(0.01)
        client.bus.put(fleet.keys.estop, EstopMessage(event="e1", actor="anna").to_json(), Priority.ESTOP)
        await asyncio.sleep(silent_s)
        fleet.net.open_way(None, host)
        await asyncio.sleep(1.5)
        states = await client.status()
        assert all(state.estop is not None and state.estop.event == "e1" for state in states.values())
        assert all(unit.at_rest() for unit in fleet.controllers.values())
        assert not any((await client.reset()).values())
        await asyncio.sleep(1.0)
        assert all(state.estop is None for state in (await client.status()).values())
        assert (await outcome(fleet, PREPARE)).state == "done"

    run_fleet(main)
