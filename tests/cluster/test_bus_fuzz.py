"""Mutated payloads on everything that is subscribed to: none is an unhandled exception, none moves an axis, and the
next job is done."""

import asyncio
import json
from random import Random
from typing import Any

import pytest
from cluster.test_queue_hostile import RAW, mutated
from cluster.worlds import PREPARE, job, outcome, run_fleet

from orchestrator.bus.base import Priority
from orchestrator.model.messages import EstopReset
from orchestrator.runtime.virtual.fleet import VirtualFleet

PAYLOADS = 5000
NIGHTLY = 500_000
AT_ONCE = 100


async def run_fuzz(fleet: VirtualFleet, seed: int, payloads: int) -> None:
    draw, keys = Random(seed), fleet.keys
    assert (await outcome(fleet, PREPARE)).state == "done"
    client = fleet.make_client("forger")
    states = {name: state.to_plain() for name, state in (await client.status()).items()}
    (_, coordinator), *_ = fleet.coordinators.values()

    def templates() -> list[tuple[str, dict[str, Any]]]:
        """Valid payloads by key, as of now."""
        event: dict[str, Any] = {"controller": "gantry", "instance": "i", "seq": 1, "kind": "info", "text": "t"}
        return [
            (keys.leader, json.loads(coordinator.leadership.make_heartbeat().to_json())),
            (keys.estop_reset, EstopReset(event="another", actor="forger").to_plain()),
            (keys.session("forged"), {"session": "forged", "actor": "forger", "controllers": ["gantry"]}),
            (keys.event("gantry"), event),
            (keys.state("nowhere"), states["gantry"] | {"controller": "nowhere"}),
        ]

    starts = {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()}
    for first in range(0, payloads, AT_ONCE):
        for _ in range(min(AT_ONCE, payloads - first)):
            key, good = draw.choice(templates())
            payload = draw.choice(RAW) if draw.random() < 0.02 else mutated(draw, good)
            client.bus.put(key, payload, Priority.EVENT)
        await asyncio.sleep(0.05)
    assert {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()} == starts
    assert not coordinator.broken.is_set() and not coordinator.leadership.over
    assert not [line for line in fleet.lines if "a defect" in line]
    assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 7, stage.u: 3}}]"))).state == "done"


@pytest.mark.parametrize("seed", range(2))
def test_mutated_payloads_on_subscribed_keys(seed: int) -> None:
    run_fleet(lambda fleet: run_fuzz(fleet, seed, PAYLOADS // 2), seed=seed)


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("seed", range(2, 10))
def test_many_mutated_payloads_on_subscribed_keys(seed: int) -> None:
    run_fleet(lambda fleet: run_fuzz(fleet, seed, NIGHTLY // 8), seed=seed)
