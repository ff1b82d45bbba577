"""Parts of different versions in one fleet: one minor version apart works, more is refused by name."""

import asyncio
import json

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet

from adapters.controller.publishing import info
from adapters.controller.state.store import AdapterMemory
from orchestrator.coordinator.leadership import leadership
from orchestrator.model.base import Model
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import AdoptRequest, BatchRequest, Request
from orchestrator.model.state import EventsRequest
from orchestrator.model.version import PROTOCOL, PartVersion, ProtocolVersion, require_version, works_with
from orchestrator.runtime.doctor.parts import find_versions
from orchestrator.runtime.virtual.fleet import VirtualFleet

NEXT = ProtocolVersion(PROTOCOL.major, PROTOCOL.minor + 1)
FAR = ProtocolVersion(PROTOCOL.major, PROTOCOL.minor + 2)
ADDED = {"added_by_a_newer_version": {"list": [1, None]}}


def test_one_minor_version_apart_works() -> None:
    expected = {
        "1.3": False,
        "1.4": True,
        "1.5": True,
        "1.6": True,
        "1.7": False,
        "2.5": False,
        "0.5": False,
        "": False,
    }
    assert {each: works_with(each, ProtocolVersion(1, 5)) for each in expected} == expected
    for other, older in ((str(FAR), "the coordinator"), ("1.0", "the adapter"), ("", "the adapter")):
        with pytest.raises(Refusal) as caught:
            require_version(PartVersion("9.8", other), "the adapter", "the coordinator")
        assert f"computer of {older}," in caught.value.remedy


def test_messages_of_a_newer_part_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything that is published and answered, and the heartbeat in a request to adopt, has a field more."""
    encode = Model.to_json

    def encode_with_more(self: Model) -> bytes:
        plain = encode(self)
        if isinstance(self, BatchRequest | EventsRequest | AdapterMemory | Fleet) or (
            isinstance(self, Request) and not isinstance(self, AdoptRequest)
        ):
            return plain
        value = json.loads(plain)
        (value["leader"] if isinstance(self, AdoptRequest) else value).update(ADDED)
        return json.dumps(value).encode()

    monkeypatch.setattr(Model, "to_json", encode_with_more)
    monkeypatch.setattr(info, "PROTOCOL", NEXT)

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 5, stage.u: 5}}]"))).state == "done"
        states = await fleet.make_client("reader").status()
        assert set(states) == set(fleet.fleet.controllers)
        assert not [each for each in await fleet.make_client("looker").list_alarms() if each.kind == "version"]
        found = await find_versions(fleet.make_client("doctor").bus, fleet.keys)
        assert [each.state for each in found] == ["ok"] * 3 and f"protocol {NEXT}" in found[1].text

    run_fleet(main)


@pytest.mark.parametrize("far", ["adapters", "coordinator"])
def test_a_part_that_is_too_far_is_refused_by_name(monkeypatch: pytest.MonkeyPatch, far: str) -> None:
    """An upgrade of one computer alone: its part comes back with another version."""

    async def main(fleet: VirtualFleet) -> None:
        if far == "adapters":
            monkeypatch.setattr(info, "PROTOCOL", FAR)
            fleet.kill("host/local")  # which its guardian starts again
        else:
            monkeypatch.setattr(leadership, "PROTOCOL", FAR)
            fleet.kill("coordinator/first")
            fleet.start_coordinator("second", take_over=True)
        await asyncio.sleep(10.0)
        client = fleet.make_client("client")
        alarms = {each.subject: each for each in await client.list_alarms() if each.kind == "version"}
        assert set(alarms) == set(fleet.fleet.controllers)
        alarm = alarms["gantry"]
        assert "gantry" in alarm.text and f"protocol {FAR}" in alarm.text and f"protocol {PROTOCOL}" in alarm.text
        assert "update Tutti on the computer of " in alarm.action
        found = await find_versions(client.bus, fleet.keys)
        failed = ["failed" if far == "adapters" else "ok"] * 2
        assert [each.state for each in found] == ["ok" if far == "adapters" else "failed", *failed]
        waiting = await client.submit(PREPARE)
        shown = await waiting.show()
        assert shown.entry is not None and "more than one minor version apart" in shown.entry.reason
        if far == "adapters":
            monkeypatch.setattr(info, "PROTOCOL", PROTOCOL)
            fleet.kill("host/local")  # which its guardian starts again
            await asyncio.sleep(5.0)
            await client.start_queue()
            async with asyncio.timeout(100):
                assert (await client.wait_for_job(waiting)).state == "done"
            await asyncio.sleep(10.0)
            assert not [each for each in await client.list_alarms() if each.kind == "version" and each.is_active]

    run_fleet(main)
