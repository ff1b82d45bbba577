"""Hostile, broken and hasty clients: every key answers with an error, and the fleet continues."""

import asyncio
import json
from random import Random
from typing import Any, cast

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.bus.base import RequestRefused
from orchestrator.bus.service_verbs import SERVICE_VERBS
from orchestrator.coordinator.coordinator import Coordinator
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import Reply
from orchestrator.model.queue import QueueTerms
from orchestrator.runtime.virtual.fleet import VirtualFleet

SHORT = job("[{do: move, by: {gantry.y: 1}}]")
SCANS = job(
    "[{do: repeat, times: 2, steps: [{do: scan, axes: {gantry.x: {from: 0, to: 1, points: 2}}, at_each:"
    " [{do: dwell, duration: 1 ms}]}, {do: scan, points: {axes: [gantry.y], rows: [[0], [1]]}}]}]"
)
LONG = job("[{do: move, to: {gantry.x: 390}, speed: 0.1}]")
HEAD = {"request_id": "r", "actor": "mallory"}

# A valid request for every key, to begin with. A key that is not listed is requested with the head alone.
SERVICE: dict[str, dict[str, Any]] = {
    "submit": {"job": SCANS.to_plain(), "client_key": "k", "terms": {"priority": 1}},
    "dry-run": {"job": SHORT.to_plain(), "first": 0, "begin": {"gantry.y": {"known": True}}},
    "list": {"limit": 5, "state": "done", "name": "x", "since": "2026-01-01T00:00:00Z"},
    "find": {"reference": "last"},
    "names": {},
    "zones": {},
    "virtual": {},
    "alarms": {"all": True, "history": 5},
    "acknowledge": {"alarm_ids": ["estop-fleet"]},
    "statistics": {"since": "2026-01-01", "by_day": True},
    "shelve": {"alarm_id": "estop-fleet", "for_s": 5.0, "why": "w"},
    "positions": {},
    "save-position": {"name": "here", "axes": ["gantry"], "values": {"gantry.x": "1 mm"}, "description": "d"},
    "remove-position": {"name": "here"},
    "show": {"job_id": "x"},
    "recording": {"job_id": "x", "step": 0},
    "points": {"job_id": "x", "after_step": -1, "after_point": 0, "limit": 5},
    "put-points": {
        "digest": f"sha256:{'0' * 64}",
        "axes": [{"axis": "gantry.x", "unit": "mm"}],
        "count": 2,
        "begin": 0,
        "data": "AAAAAAAA8D8=",
    },
    "cancel": {"job_id": "x"},
    "retry": {"job_id": "x", "from_step": 1, "client_key": "k2", "terms": None, "dry_run": True},
    "hold": {"job_ids": ["x"]},
    "release": {"job_ids": ["x"]},
    "plan": {"job_id": "x"},
    "approve": {"job_id": "x", "plan": f"sha256:{'0' * 64}"},
    "commands": {"limit": 5, "before": "2026-01-01T00:00:00Z", "by": "a"},
    "configuration": {},
    "reorder": {"job_id": "x", "before": "y"},
    "pause": {"job_id": "x"},
    "resume": {"job_id": "x"},
    "override": {"job_id": "x", "percent": 50},
    "retarget": {"job_id": "x", "to": {"gantry.x": 1}, "by": {}},
    "go": {"job_id": "x", "at_fleet_ns": None},
    "ask-live": {"job_id": "x", "steps": [{"do": "move", "to": {"gantry.x": 1}}]},
    "read-live": {"job_id": "x", "number": 0},
    "stop-live": {"job_id": "x"},
    "end-live": {"job_id": "x"},
    "prune": {"older_s": 1e9, "keep": 10},
    "preview-start": {},
    "start-queue": {},
    "stop-queue": {},
    "stop": {"mode": "decelerate"},
    "acquire-axes": {"axes": ["gantry.x"], "holder": "manual-1", "what": "w", "ttl_s": 0.5, "reserve": False},
    "release-axes": {"holder": "manual-1"},
    "reload": {"configuration": demo_fleet().to_plain()},
    "check-wiring": {},
    "repair-epoch": {},
    "forget-times": {"controllers": []},
    "hand-over": {},
}
COMMANDS: dict[str, dict[str, Any]] = {
    "adopt": {"leader": {}},
    "lease": {"axes": ["x"], "holder": "manual-1", "ttl_ms": 1000},
    "propose": {"job": "j", "step": 0, "digest": "", "duration_s": 1.0, "profiles": {}},
    "arm": {"job": "j", "step": 0, "digest": "", "t0_fleet_ns": 1, "profiles": {}},
    "commit": {"job": "j", "step": 0, "t0_fleet_ns": 1},
    "go": {"job": "j", "step": 0, "t0_fleet_ns": 1},
    "load-chunk": {
        **{"job": "j", "step": 0, "t0_fleet_ns": 1, "number": 1, "begin_s": 0.0},
        **{"chunk": {"end_s": 1.0, "last": True}, "profiles": {}},
    },
    "release-chunk": {"job": "j", "step": 0, "t0_fleet_ns": 1, "number": 1},
    "disarm": {"job": "j", "step": 0},
    "stop": {"mode": "abort", "reason": "r"},
    "enable": {"axes": ["x"], "on": False, "holder": "h"},
    "home": {"axes": ["x"], "holder": "h"},
    "jog": {"holder": "manual-1", "seq": 1, "velocities": {"x": 1.0}, "valid_ms": 100},
    "set-position": {"axes": ["x"], "holder": "h", "position": "1 mm"},
    "output": {"output": "lamp", "value": True},
    "configure": {"configuration": {}, "check": True},
    "reset": {"event": None, "check": True},
    "raw": {"holder": "h", "command": "MG TIME", "i_know": False},
    "forget": {},
}
NASTY: tuple[Any, ...] = (
    *(None, True, -1, 0, 2**53, -(2**63), 10**400, 1e308, "", "x" * 100_000, "\u0000", "\ud800", "../../etc/passwd"),
    *("'; DROP TABLE jobs; --", "*", "**", "$*", "1e999999999 mm", "9" * 5000 + " s", "0001-01-01T00:00:00+14:00"),
    *([], {}, [list[Any]()] * 50, {"a": {"b": {"c": None}}}, [0] * 20_000, ["gantry"] * 2000),
)
RAW = (
    *(b"", b"null", b"[]", b"0", b'"text"', b"{", b"\xff\xfe\x00", b"{}" * 1000, b"[" * 100_000, b'{"a":' * 5000),
    *(b"NaN", b'{"request_id": NaN}', b'{"request_id": "r", "actor": "m"}', b" " * 1_000_000, bytes(range(256))),
)


def below(place: Any) -> list[Any]:
    """The keys of the objects nested in `place`; none of a plain value."""
    if isinstance(place, dict):
        return list(cast("dict[str, Any]", place))
    return list(range(len(cast("list[Any]", place)))) if isinstance(place, list) else []


def mutated(draw: Random, good: dict[str, Any]) -> bytes:
    """A request with something wrong in it, or a good one cut or stirred."""
    value: Any = json.loads(json.dumps(good)) | {"request_id": f"{draw.getrandbits(64):x}"}
    place: Any = value
    key: Any = draw.choice(sorted(value))
    # Down into what is nested, sometimes.
    while (keys := below(place[key])) and draw.random() < 0.7:
        place, key = place[key], draw.choice(keys)
    way = draw.random()
    if way < 0.7:
        place[key] = draw.choice(NASTY)
    elif way < 0.8 and isinstance(place, dict):
        del place[key]
    elif isinstance(place, dict):
        place[draw.choice(("extra", "__class__", ""))] = draw.choice(NASTY)
    data = json.dumps(value).encode()
    if way > 0.95:
        data = data[: draw.randrange(len(data))]
    elif way > 0.9:
        at = draw.randrange(len(data))
        data = data[:at] + bytes([draw.randrange(256)]) + data[at + 1 :]
    return data


MUTATIONS = pytest.mark.parametrize("count", [4, pytest.param(25, marks=pytest.mark.nightly)])


async def ask(fleet: VirtualFleet, key: str, payload: bytes) -> None:
    """Send the request; any answer is valid, but there must be one."""
    bus = fleet.make_client("mallory").bus
    try:
        answer = await bus.request(key, payload, timeout_s=120.0)
    except RequestRefused as refused:
        assert str(refused)
        return
    finally:
        await bus.close()
    assert isinstance(json.loads(answer), dict)


@MUTATIONS
def test_no_payload_ends_the_service(count: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        for verb, fields in SERVICE.items():
            draw = Random(verb)
            good = HEAD | fields
            payloads = [*RAW, *(mutated(draw, good) for _ in range(count))]
            for payload in payloads:
                await ask(fleet, fleet.keys.service(verb), payload)
            await client.start_queue()
            await client.release_jobs()
            while waiting := (await client.list_jobs(state="queued")).jobs:
                for each in waiting:
                    await client.cancel_job(each.id)
            assert (await outcome(fleet, PREPARE, SHORT)).state == "done", verb

    run_fleet(main)


def test_every_key_of_the_service_is_tried() -> None:
    async def main(fleet: VirtualFleet) -> None:
        coordinator: Coordinator = fleet.coordinators["first"][1]
        assert set(SERVICE) == SERVICE_VERBS.keys() == coordinator._requests._handlers.keys()
        with pytest.raises(RequestRefused, match="unknown verb 'nothing'; known verbs: acknowledge, acquire-axes"):
            await fleet.make_client().bus.request(fleet.keys.service("nothing"), b"{}", timeout_s=1.0)

    run_fleet(main)


@MUTATIONS
@pytest.mark.parametrize("controller", ["gantry", "stage"])
def test_no_payload_ends_an_adapter(controller: str, count: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        throne = fleet.coordinators["first"][1].leadership
        for verb, more in COMMANDS.items():
            draw = Random(verb)
            good = HEAD | more
            if verb not in ("stop", "jog", "reset", "raw", "forget"):
                # As if it were the coordinator itself that has lost its mind.
                good |= {"epoch": throne.epoch, "coordinator": throne.coordinator}
            for payload in [*RAW, *(mutated(draw, good) for _ in range(count))]:
                await ask(fleet, fleet.keys.command(controller, verb), payload)
        await fleet.make_client().reset()
        assert (await outcome(fleet, PREPARE, SHORT)).state == "done"

    run_fleet(main)


def test_a_thousand_cancels_at_once() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        running = await client.submit(LONG)
        jobs = [running, *[await client.submit(SHORT) for _ in range(9)]]
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        asked = [client.cancel_job(jobs[number % 10]) for number in range(1000)]
        answers = await asyncio.gather(*asked, return_exceptions=True)
        assert all(each is None or isinstance(each, Refusal) for each in answers)
        for each in jobs:
            report = await client.wait_for_job(each)
            assert report.state == "cancelled"
            assert [change.state for change in report.transitions].count("cancelled") == 1
        assert (await outcome(fleet, SHORT)).state == "done"

    run_fleet(main)


def test_a_client_that_vanishes_after_its_submission() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = fleet.controllers["gantry"].position("Y")
        for number in range(5):
            client = fleet.make_client("mayfly")
            submission = asyncio.ensure_future(client.submit(SHORT, f"mayfly-{number}"))
            # Before the request arrives, on its way, and after the answer.
            await asyncio.sleep(0.0003 * number)
            fleet.net.kill_process(client.bus.name)  # type: ignore[attr-defined]
            submission.cancel()
        await asyncio.sleep(20)
        jobs = (await fleet.make_client().list_jobs(state="done", name="test")).jobs
        moved = len(jobs) - 1  # without the preparation
        assert 1 <= moved <= 5
        assert fleet.controllers["gantry"].position("Y") == before + 1000 * moved

    run_fleet(main)


def test_a_journal_that_cannot_be_written_refuses_and_forgets_nothing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        db = fleet.journal.database.connection
        moving, queued = await client.submit(LONG), await client.submit(SHORT, terms=QueueTerms(held=True))
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        db.execute("PRAGMA query_only=ON")
        for asked in (
            client.submit(SHORT),
            client.cancel_job(queued),
            client.hold_jobs(queued),
            client.release_jobs(queued),
        ):
            if asked.__name__ == "hold_jobs":
                await asked  # it is held already: nothing to note
                continue
            with pytest.raises(Refusal, match="readonly database") as caught:
                await asked
            assert caught.value.code == "journal"
            assert "free space" in caught.value.remedy
        # A moving axis can be stopped in any state of the journal.
        await client.stop()
        await fleet.wait_until(lambda states: states["gantry"].mode == "idle")
        await asyncio.sleep(30)
        db.execute("PRAGMA query_only=OFF")
        await asyncio.sleep(10)
        assert (await client.wait_for_job(moving)).state == "aborted"
        await client.start_queue()
        await client.release_jobs(queued)
        assert (await client.wait_for_job(queued)).state == "done"

    run_fleet(main)


@pytest.mark.parametrize("begun", [True, False])
def test_a_job_does_not_start_while_the_journal_cannot_record_it(monkeypatch: pytest.MonkeyPatch, begun: bool) -> None:
    """A running job fails at its next step; one that was about to start, and has its axes, waits, and acquires them
    again."""

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        db = fleet.journal.database.connection
        held = await client.submit(SHORT, terms=QueueTerms(held=True))
        before = fleet.controllers["gantry"].position("Y")
        take, taken, released = LeaseRegistry.acquire, asyncio.Event(), asyncio.Event()

        async def take_as_the_disk_fails(leases: LeaseRegistry, *who: Any) -> Any:
            axes = await take(leases, *who)
            if not begun and not taken.is_set():
                await released.wait()
                db.execute("PRAGMA query_only=ON")
            taken.set()
            return axes

        monkeypatch.setattr(LeaseRegistry, "acquire", take_as_the_disk_fails)
        blocked = await client.submit(job("[{do: dwell, duration: 2 s}, {do: move, by: {gantry.y: 1}}]"))
        await client.release_jobs(held)
        released.set()
        while begun and (await blocked.show()).transitions[-1].state != "running":
            await asyncio.sleep(0.01)
        await taken.wait()
        db.execute("PRAGMA query_only=ON")
        await asyncio.sleep(20)
        assert fleet.controllers["gantry"].position("Y") == before
        db.execute("PRAGMA query_only=OFF")
        report = await client.wait_for_job(blocked)
        if begun:  # it has failed, and the other one needs the same controller
            shown = (await held.show()).entry
            assert shown is not None and shown.held_by == f"job {blocked}"
            await held.release()
        states = [report.state, (await client.wait_for_job(held)).state]
        assert states == ["failed" if begun else "done", "done"]
        assert fleet.controllers["gantry"].position("Y") == before + (1000 if begun else 2000)

    run_fleet(main)


@pytest.mark.parametrize("value", ["1e999999999 mm", "1e90", "1e-999999 mm", "9" * 5000, 1e308, 10**400, 2**63])
def test_no_quantity_is_too_large_to_be_refused(value: Any) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        throne = fleet.coordinators["first"][1].leadership
        for step in ({"do": "move", "to": {"gantry.x": value}}, {"do": "set-position", "axes": {"gantry.x": value}}):
            plain = {**SHORT.to_plain(), "steps": [step]}
            request = {**HEAD, "job": plain, "client_key": str(step)}
            await ask(fleet, fleet.keys.service("submit"), json.dumps(request).encode())
        request = {**HEAD, "epoch": throne.epoch, "coordinator": throne.coordinator, "axes": ["x"], "holder": "h"}
        await ask(
            fleet, fleet.keys.command("gantry", "set-position"), json.dumps({**request, "position": value}).encode()
        )
        assert (await outcome(fleet, SHORT)).state == "done"

    run_fleet(main)


def test_a_reply_is_readable_as_a_refusal() -> None:
    async def main(fleet: VirtualFleet) -> None:
        payload = json.dumps({**HEAD, "job_id": "nothing"}).encode()
        answer = await fleet.make_client().bus.request(fleet.keys.service("cancel"), payload, timeout_s=1.0)
        refused = Reply.model_validate_json(answer).refused
        assert refused is not None
        assert (refused.code, refused.text, refused.remedy) == ("unknown-job", "no job nothing", "see `tutti job ls`")

    run_fleet(main)
