"""Requests to members on many hosts: bounded, and none waits for a slow host."""

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from orchestrator.bus.base import RequestTimeout
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.fleet.requests import MAX_UNDER_WAY, MemberRequests
from orchestrator.model.messages import Reply, Request

SLOW_S = 2.0
HOSTS = 100


def test_a_slow_host_delays_no_other_and_its_member_is_named() -> None:
    under_way, most, ended_s = 0, 0, dict[str, float]()

    async def main(clock: VirtualClock) -> None:
        async def request(key: str, payload: bytes, timeout_s: float, server: str | None) -> bytes:
            nonlocal under_way, most
            under_way += 1
            most = max(most, under_way)
            is_slow = "/c7/" in key
            await asyncio.sleep(SLOW_S if is_slow else 0.01)
            under_way -= 1
            ended_s[key] = clock.loop.time()
            if is_slow:
                raise RequestTimeout(key)
            return Reply().to_json()

        names = [f"c{number}" for number in range(HOSTS)]
        controllers = {name: SimpleNamespace(host=f"h-{name}") for name in names}
        view = SimpleNamespace(servers={}, fleet=SimpleNamespace(controllers=controllers))
        bus = SimpleNamespace(request=request)
        requests = MemberRequests(cast(Any, bus), FleetKeys("demo"), cast(Any, None), lambda: "id", cast(Any, view))
        asked = {name: Request(request_id="id", actor="anna") for name in names}
        took_ns: dict[str, int] = {}
        replies = await requests.request_all("stop", asked, Reply, SLOW_S, answered=took_ns.__setitem__)
        refused = {name: reply.refused for name, reply in replies.items() if reply.refused is not None}
        assert list(refused) == ["c7"] and refused["c7"].code == "no-answer" and refused["c7"].member == "c7"
        assert most == MAX_UNDER_WAY == 16
        # 99 others by the 15 places that the slow one leaves.
        assert sorted(ended_s.values())[-2] == pytest.approx(0.01 * 7)
        # The wait for a place does not count.
        assert {round(ns / 1e6) for name, ns in took_ns.items() if name != "c7"} == {10}

    run_virtual(main)
