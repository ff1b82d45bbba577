"""Requests to several controllers of a host in one message: each answers for itself, and a wrong or slow one does
not delay the answers of the others."""

import asyncio
import json
from random import Random
from typing import Any

import pytest
from cluster.test_queue_hostile import COMMANDS, HEAD, RAW, SHORT, ask, mutated
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from adapters.controller.commands import ControllerCommands
from adapters.controller.slots.participant import StepParticipant
from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.coordinator import Coordinator
from orchestrator.coordinator.fleet.requests import MemberRequests
from orchestrator.model.messages import BatchReply, CommitRequest, CommittedReply, EnableRequest, Reply
from orchestrator.model.messages import Request as Asked
from orchestrator.runtime.virtual.fleet import VirtualFleet

BOTH = job("[{do: move, to: {gantry.x: 10, stage.u: 1}}]", max_start_skew="20 ms")
FORGET = {**HEAD, "request_id": "t"}


async def together(fleet: VirtualFleet, verb: str, requests: dict[str, Any], within_ms: int = 1000) -> BatchReply:
    texts = {name: each if isinstance(each, str) else json.dumps(each) for name, each in requests.items()}
    payload = json.dumps({"requests": texts, "answer_within_ns": within_ms * NS_PER_MS}).encode()
    bus = fleet.make_client("asker").bus
    try:
        said = await bus.request(fleet.keys.batch_command("local", verb), payload, timeout_s=5.0)
        return BatchReply.model_validate_json(said)
    finally:
        await bus.close()


def members(fleet: VirtualFleet) -> MemberRequests:
    coordinator: Coordinator = fleet.coordinators["first"][1]
    return coordinator._fleet.requests  # pyright: ignore[reportPrivateUsage]


def enabling(fleet: VirtualFleet, **axes: list[str]) -> dict[str, Asked]:
    fields = members(fleet).request_fields("tester")
    return {name: EnableRequest(**fields, axes=each, holder="absent", on=True) for name, each in axes.items()}


@pytest.mark.parametrize("verb", ["stop", "commit", "lease", "nothing"])
def test_no_payload_ends_a_host(verb: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        draw = Random(verb)
        inner = json.dumps(HEAD | COMMANDS.get(verb, {}))
        good = {"requests": {"gantry": inner, "stage": inner}, "answer_within_ns": 10**9}
        payloads = [*RAW, *(mutated(draw, good) for _ in range(25))]
        # Malformed inside, too: the request for one controller.
        payloads += [
            json.dumps({**good, "requests": {"gantry": each.decode("latin-1"), "stage": inner}}).encode()
            for each in (mutated(draw, HEAD | COMMANDS.get(verb, {})) for _ in range(25))
        ]
        for payload in payloads:
            await ask(fleet, fleet.keys.batch_command("local", verb), payload)
        # A controller that was not waited for continues: a stop must run to its end.
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        await fleet.make_client().reset()
        for each in (PREPARE, SHORT):
            report = await outcome(fleet, each)
            assert report.state == "done", report.reason

    run_fleet(main)


def test_each_answers_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = ControllerCommands.answer_command

    async def broken(commands: ControllerCommands, sample: BusSample) -> bytes:
        defect = json.dumps(FORGET).encode() == sample.payload
        if defect and commands._context.controller == "stage":  # pyright: ignore[reportPrivateUsage]
            raise KeyError("a defect")
        return await answer(commands, sample)

    monkeypatch.setattr(ControllerCommands, "answer_command", broken)

    async def main(fleet: VirtualFleet) -> None:
        faults: list[dict[str, Any]] = []
        # In virtual time it would end the run.
        monkeypatch.setattr(asyncio.get_running_loop(), "call_exception_handler", faults.append)
        said = await together(fleet, "forget", {"gantry": FORGET, "stage": FORGET, "absent": FORGET})
        assert set(said.replies) == {"gantry"} and Reply.model_validate_json(said.replies["gantry"]).refused is None
        assert "KeyError while answering forget for stage" in said.errors["stage"] and len(faults) == 1
        assert set(said.took_ns) == {"gantry", "stage"}
        said = await together(fleet, "forget", {"gantry": "{", "stage": {**HEAD, "more": 1}})
        assert not said.replies and "forget: payload" in said.errors["gantry"] and "more" in said.errors["stage"]
        with pytest.raises(RequestRefused, match="requests"):
            await together(fleet, "forget", {})
        said = await together(fleet, "nothing", {"gantry": FORGET})
        assert "unknown verb 'nothing'" in said.errors["gantry"]

    run_fleet(main)


def test_a_slow_host_is_left_out_and_its_answer_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    async def slow(commands: ControllerCommands, _: Asked) -> Reply:
        made.append(commands._context.controller)  # pyright: ignore[reportPrivateUsage]
        if made[-1] == "stage":
            await sleep_ns(commands._context.clock, 300 * NS_PER_MS)  # pyright: ignore[reportPrivateUsage]
        return Reply()

    monkeypatch.setattr(ControllerCommands, "_handle_forget", slow)

    async def main(fleet: VirtualFleet) -> None:
        asked = {"gantry": FORGET, "stage": FORGET}
        said = await together(fleet, "forget", asked, within_ms=100)
        assert set(said.replies) == {"gantry"} == set(said.took_ns) and not said.errors
        said = await together(fleet, "forget", asked)
        assert set(said.replies) == {"gantry", "stage"} and sorted(made) == ["gantry", "stage"]
        # An answered request is not repeated, and the slow controller had been working for a tenth of a second already.
        assert said.took_ns["gantry"] < 10 * NS_PER_MS < said.took_ns["stage"] < 250 * NS_PER_MS

    run_fleet(main)


def test_a_step_sends_one_request_per_host_and_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, ...]] = []
    plain, common = MemberRequests._request_reply, MemberRequests._request_batch  # pyright: ignore[reportPrivateUsage]

    async def alone(self: MemberRequests, member: str, verb: str, *rest: Any) -> Any:
        asked.append((verb, member))
        return await plain(self, member, verb, *rest)

    async def with_others(self: MemberRequests, verb: str, requests: Any, *rest: Any) -> Any:
        asked.append((verb, *requests))
        return await common(self, verb, requests, *rest)

    monkeypatch.setattr(MemberRequests, "_request_reply", alone)
    monkeypatch.setattr(MemberRequests, "_request_batch", with_others)
    stages = ["lease", "check-settings", "propose", "arm", "commit", "go", "lease"]

    def run_on(hosts: dict[str, str], expected: list[tuple[str, ...]]) -> None:
        whole = demo_fleet().to_plain()
        for name, host in hosts.items():
            whole["controllers"][name]["host"] = host

        async def main(fleet: VirtualFleet) -> None:
            await outcome(fleet, PREPARE)
            asked.clear()
            assert (await outcome(fleet, BOTH)).state == "done"
            rounds = [each for k, each in enumerate(asked) if not (each[0] == "propose" and each in asked[:k])]
            assert sorted(rounds) == sorted(expected)

        run_fleet(main, type(demo_fleet()).model_validate(whole))

    run_on({}, [(stage, "gantry", "stage") for stage in stages])
    run_on({"stage": "other"}, [(stage, name) for stage in stages for name in ("gantry", "stage")])


def test_an_answer_missing_from_a_host_is_a_refusal_that_names_the_member(monkeypatch: pytest.MonkeyPatch) -> None:
    commit = StepParticipant.commit_step

    async def silent(member: StepParticipant, request: CommitRequest) -> Reply:
        if member._context.controller == "stage":  # pyright: ignore[reportPrivateUsage]
            await sleep_ns(member._context.clock, 500 * NS_PER_MS)  # pyright: ignore[reportPrivateUsage]
        return await commit(member, request)

    monkeypatch.setattr(StepParticipant, "commit_step", silent)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        asks = members(fleet)
        said = await asks.request_all("enable", enabling(fleet, gantry=["x"], stage=["u"]), Reply)
        assert {each.refused.code for each in said.values() if each.refused} == {"not-leased"}
        commits = {
            name: CommitRequest(**asks.request_fields("tester"), job="j", step=0, t0_fleet_ns=2**50)
            for name in ("gantry", "stage")
        }
        said = await asks.request_all("commit", commits, CommittedReply, 0.2)
        codes = {name: each.refused.code for name, each in said.items() if each.refused}
        assert codes == {"gantry": "not-armed", "stage": "no-answer"}
        refused = said["stage"].refused
        assert (
            refused is not None and refused.member == "stage" and "has not answered commit within 0.2 s" in refused.text
        )
        said = await asks.request_all("nothing", commits, Reply, 0.2)
        assert {each.refused.code for each in said.values() if each.refused} == {"bad-request"}
        fleet.kill("host/local")
        said = await asks.request_all("commit", commits, CommittedReply, 0.2)
        codes = {name: each.refused.code for name, each in said.items() if each.refused}
        assert codes == {"gantry": "absent", "stage": "absent"}

    run_fleet(main)
