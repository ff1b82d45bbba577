"""A cause that goes away never starts motion: what waited for it begins only by a word for what was shown."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from cluster.worlds import PREPARE, begin_ready, demo_fleet, job, outcome, run_fleet

from orchestrator.bus.estop import put_estop
from orchestrator.client.api import Tutti
from orchestrator.client.ready import ReadyToBegin
from orchestrator.client.results import JobResult
from orchestrator.coordinator.jobs.queue.conditions import ESTOP_VISIBLE_NS
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Permit, QueuePolicy
from orchestrator.model.jobs.restart import RESTART, StartPreview
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import QueueEntry
from orchestrator.runtime.virtual.fleet import VirtualFleet

Main = Callable[[VirtualFleet], Coroutine[Any, Any, None]]

DOOR = Permit(input="gantry.door", value=False)
SHORT = job("[{do: move, to: {gantry.x: 5}}]")
STAGE = job("[{do: move, to: {stage.u: 1}}]")
LONG_S = 20.0


def guarded(permit: Permit = DOOR, **queue: str) -> Any:
    policy = QueuePolicy.model_validate({"on_restart": "continue", **queue})
    return demo_fleet().model_copy(update={"permits": {"door-closed": permit}, "queue": policy})


async def set_door(fleet: VirtualFleet, *, is_open: bool) -> None:
    fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=not is_open))
    await fleet.wait_until(lambda states: states["gantry"].inputs["door"] == is_open)


async def submit_behind_the_door(fleet: VirtualFleet, client: Tutti) -> str:
    """Submit a job that has to wait for the door, and close the door."""
    await set_door(fleet, is_open=True)
    waiting = await client.submit(SHORT)
    await asyncio.sleep(1.0)
    await set_door(fleet, is_open=False)
    return waiting


async def find_entry(client: Tutti, job_id: str) -> QueueEntry:
    entry = (await client.show_job(job_id)).entry
    assert entry is not None
    return entry


def count_motions(fleet: VirtualFleet) -> int:
    return sum(len(unit.commanded_motions) for unit in fleet.controllers.values())


async def open_and_close(fleet: VirtualFleet, client: Tutti) -> Callable[[], Coroutine[Any, Any, None]]:
    await set_door(fleet, is_open=True)

    async def clear() -> None:
        await set_door(fleet, is_open=False)

    return clear


async def stop_and_reset(fleet: VirtualFleet, client: Tutti) -> Callable[[], Coroutine[Any, Any, None]]:
    await client.estop("a test")
    await asyncio.sleep(2.0)
    await client.start_queue()

    async def clear() -> None:
        await client.reset()

    return clear


async def cut_and_mend(fleet: VirtualFleet, client: Tutti) -> Callable[[], Coroutine[Any, Any, None]]:
    fleet.wires["gantry"].cut = True
    await fleet.wait_until(lambda states: states["gantry"].mode == "offline")

    async def clear() -> None:
        fleet.wires["gantry"].cut = False
        await fleet.wait_until(lambda states: states["gantry"].mode == "idle")

    return clear


async def disable_and_enable(fleet: VirtualFleet, client: Tutti) -> Callable[[], Coroutine[Any, Any, None]]:
    await client.disable("gantry.x")

    async def clear() -> None:
        await client.enable("gantry.x")

    return clear


@pytest.mark.parametrize("cause", [open_and_close, stop_and_reset, cut_and_mend, disable_and_enable])
def test_a_job_that_waited_for_a_cause_and_those_behind_it_begin_only_by_a_word(cause: Any) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        clear = await cause(fleet, client)
        first, behind = await client.submit(SHORT), await client.submit(job("[{do: move, to: {gantry.x: 9}}]"))
        await asyncio.sleep(2.0)
        assert (await find_entry(client, first)).reason.startswith("waits for: ")
        before = count_motions(fleet)
        await clear()
        await asyncio.sleep(LONG_S)
        assert count_motions(fleet) == before
        entries = [await find_entry(client, job_id) for job_id in (first, behind)]
        assert [(entry.held_by, entry.ready) for entry in entries] == [(RESTART, True), (RESTART, False)]
        assert entries[0].reason.startswith("ready to begin")
        await begin_ready(client, first)
        assert [(await client.wait_for_job(job_id)).state for job_id in (first, behind)] == ["done", "done"]

    run_fleet(main, guarded())


def test_other_controllers_are_not_concerned_and_time_and_jobs_need_no_word() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await set_door(fleet, is_open=True)
        waiting = await client.submit(SHORT)
        after = await client.submit(STAGE)
        last = await client.submit(job("[{do: move, to: {stage.u: 2}}]"), terms=QueueTerms(after=after.id))
        assert [(await client.wait_for_job(job_id)).state for job_id in (after, last)] == ["done", "done"]
        assert (await find_entry(client, waiting)).state == "queued"

    run_fleet(main, guarded(Permit(input="gantry.door", value=False, axes=["gantry"])))


def test_a_job_that_comes_just_after_a_reset_has_waited_for_nothing() -> None:
    """However quickly it was reset: the coordinator has received both latch and reset of each controller."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        pressed_ns = fleet.clock.now_ns()
        assert all((await client.estop("a test")).values())
        assert not any((await client.reset()).values())
        await client.start_queue()
        entry = await client.enqueue_job(job("[{do: enable, axes: [gantry.x]}, {do: home, axes: [gantry.x]}]"))
        assert fleet.clock.now_ns() - pressed_ns < ESTOP_VISIBLE_NS
        assert entry.reason == "submitted" and (await client.wait_for_job(entry.id)).state == "done"

    run_fleet(main, guarded())


def test_a_job_waits_for_an_e_stop_that_its_controllers_do_not_show_yet() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        put_estop(client.bus, client.keys.fleet, "e1", "anna", "a test")
        await client.start_queue()
        entry = await client.enqueue_job(SHORT)
        assert entry.reason.startswith("waits for: e-stop by anna: a test")

    run_fleet(main, guarded())


def test_a_submission_says_at_once_what_it_waits_for() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await set_door(fleet, is_open=True)
        entry = await client.enqueue_job(SHORT)
        assert entry.reason.startswith("waits for: permit door-closed does not hold")
        assert entry.reason.endswith("then its start has to be asked for")

    run_fleet(main, guarded())


def test_a_word_while_the_cause_lasts_counts_for_nothing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await set_door(fleet, is_open=True)
        waiting = await client.submit(SHORT)
        await asyncio.sleep(1.0)
        preview = await client.start_queue()
        assert (preview.motions, [motion.job_id for motion in preview.lasting]) == ([], [waiting])
        with pytest.raises(Refusal, match="permit door-closed") as refused:
            await client.release_jobs(waiting)
        assert refused.value.code == "cause-lasts"
        await set_door(fleet, is_open=False)
        await asyncio.sleep(LONG_S)
        assert (await find_entry(client, waiting)).ready

    run_fleet(main, guarded())


def test_the_preview_names_a_cause_that_a_job_has_not_met_because_the_queue_is_stopped() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await client.stop_queue()
        waiting = await client.submit(SHORT)
        await set_door(fleet, is_open=True)
        preview = await client.preview_start()
        assert (preview.motions, [motion.job_id for motion in preview.lasting]) == ([], [waiting])
        assert "permit door-closed" in preview.lasting[0].cause

    run_fleet(main, guarded())


def test_a_word_counts_only_for_the_motion_that_was_shown() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        waiting = await submit_behind_the_door(fleet, client)
        await asyncio.sleep(1.0)
        shown = await client.preview_start()
        assert [(motion.text, motion.axes) for motion in shown.motions] == [
            ("step 1: move to gantry.x=5", ["gantry.x"]),
        ]
        await client.hold_jobs(waiting)
        for stale in (shown, StartPreview(shown="0123456789abcdef")):
            with pytest.raises(Refusal) as refused:
                await client.start_queue(stale)
            assert refused.value.code == "not-shown"
        await client.release_jobs(waiting)
        assert (await client.wait_for_job(waiting)).state == "done"

    run_fleet(main, guarded())


def test_a_new_leader_asks_as_well() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        waiting = await submit_behind_the_door(fleet, client)
        fleet.start_coordinator("second", standby=True)
        fleet.kill("coordinator/first")
        await asyncio.sleep(LONG_S)
        before = count_motions(fleet)
        await asyncio.sleep(LONG_S)
        assert count_motions(fleet) == before
        await begin_ready(client, waiting)
        assert (await client.wait_for_job(waiting)).state == "done"

    run_fleet(main, guarded())


@pytest.mark.parametrize(
    ("permit", "queue", "asks"),
    [
        (DOOR, "begin", False),
        (Permit(input="gantry.door", value=False, on_clear="begin"), "ask", False),
        (Permit(input="gantry.door", value=False, on_clear="ask"), "begin", True),
    ],
)
def test_the_fleet_file_may_let_jobs_begin_when_a_cause_is_gone(permit: Permit, queue: str, asks: bool) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        waiting = await submit_behind_the_door(fleet, client)
        await asyncio.sleep(LONG_S)
        assert ((await find_entry(client, waiting)).state == "queued") is asks

    run_fleet(main, guarded(permit, on_clear=queue))


@pytest.mark.parametrize("answer", [None, False, True])
def test_what_waits_for_a_job_in_python_is_given_what_moves_first(answer: bool | None) -> None:
    """`run` and `wait` show it to a callback; without one, or by its no, nothing begins."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await set_door(fleet, is_open=True)
        shown: list[str] = []

        async def decide(preview: StartPreview) -> bool:
            shown.extend(motion.text for motion in preview.motions)
            return bool(answer)

        on_ready = None if answer is None else decide
        submitted = await client.submit(STAGE)
        waiting = asyncio.ensure_future(submitted.wait(on_ready))
        running = asyncio.ensure_future(client.run(SHORT, wait=True, on_ready=on_ready))
        await asyncio.sleep(2.0)
        assert not waiting.done() and not running.done()
        await set_door(fleet, is_open=False)
        result = await waiting
        assert result.state == ("done" if answer else "ready-to-begin")
        assert isinstance(result, JobResult) is bool(answer)
        if answer:
            await running
            assert sorted(shown) == ["step 1: move to gantry.x=5", "step 1: move to stage.u=1"]
            return
        with pytest.raises(ReadyToBegin, match=r"first it would move .*gantry\.x=5") as refused:
            await running
        assert refused.value.code == "ready-to-begin"
        await asyncio.sleep(LONG_S)
        assert (await client.list_jobs(state="queued")).total == 1

    run_fleet(main, guarded())


def test_a_person_is_not_kept_from_the_remedy_by_a_command_that_waits_for_it() -> None:
    """`axis move --wait` in one terminal waits for a motor that `axis enable` in another one switches on."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        anna, ben = fleet.make_client("anna"), fleet.make_client("ben")
        await anna.disable("gantry")
        moving = asyncio.ensure_future(anna.run(SHORT, wait=True, on_ready=lambda _: True))
        await asyncio.sleep(2.0)
        await ben.enable("gantry")
        assert (await moving).state == "done"

    run_fleet(main, guarded())
