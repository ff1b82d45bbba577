"""What would outlive a certificate of its members is refused before it begins."""

import json
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, refusal

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.fleet.certificates import ENDS_BEFORE
from orchestrator.model.errors import Refusal
from orchestrator.model.queue import QueueTerms
from orchestrator.model.state import CertificateEnd
from orchestrator.runtime.virtual.fleet import VirtualFleet

END = "2026-01-01T00:05:00Z"  # virtual time begins at midnight
SHORT = job("[{do: move, to: {gantry.x: 5}}]")
LONG = job("[{do: move, to: {gantry.x: 300, stage.u: 12}, speed: 0.002}]")  # some 500 s
FAR = job("[{do: move, by: {gantry.x: 300}, speed: 0.002}]")  # its duration is known wherever it begins


def run_with(main: Callable[[VirtualFleet], Coroutine[Any, Any, None]], end: str = END, **names: str) -> None:
    """Run `main` with a fleet whose adapter host `local`, or coordinator `own`, has a certificate of that name."""

    async def run(clock: VirtualClock) -> None:
        fleet = VirtualFleet(demo_fleet(), clock, 1)
        for part, name in names.items():
            fleet.certificates["" if part == "own" else part] = CertificateEnd(name=name, ends_utc=end)
        await fleet.start()
        await main(fleet)

    run_virtual(run)


def test_a_step_that_would_outlive_the_certificate_of_its_host_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        refused = await refusal(fleet, PREPARE, SHORT, LONG)
        assert refused.code == ENDS_BEFORE and refused.member == "gantry", refused
        assert refused.text.startswith(
            "gantry (adapter host local): its certificate host-local.2 ends at 2026-01-01 00:05:00 UTC, and this would "
            "end at 2026-01-01 00:"
        )
        assert refused.remedy == "`tutti keys renew host-local`, copy its folder, and restart adapter host local"
        assert fleet.controllers["gantry"].commanded_motions[-1].end_ns is not None  # that of SHORT
        count = len(fleet.controllers["gantry"].commanded_motions)
        # A dry run names the step by which it is too late; a dwell counts, and so does what comes before.
        half = "{do: dwell, duration: 150 s}"
        forecast = await client.dry_run(job(f"[{half}, {half}, {{do: move, to: {{gantry.x: 6}}}}]"))
        assert [(each.place, each.code) for each in forecast.problems] == [(["steps", 1], ENDS_BEFORE)]
        assert (await client.dry_run(SHORT)).problems == []
        assert (await client.dry_run(LONG)).problems[0].code == ENDS_BEFORE
        for late, terms in ((FAR, QueueTerms()), (SHORT, QueueTerms(at="2026-01-01T01:00:00Z"))):
            with pytest.raises(Refusal, match=r"host-local\.2 ends at") as caught:
                await client.submit(late, terms=terms)
            assert caught.value.code == ENDS_BEFORE
        # A wait that ends too late is refused at its beginning; no axis moves meanwhile.
        assert (await outcome(fleet, job("[{do: enable, axes: [stage]}, {do: dwell, duration: 10 s}]"))).state == "done"
        assert len(fleet.controllers["gantry"].commanded_motions) == count
        assert (await outcome(fleet, SHORT)).state == "done"

    run_with(main, local="host-local.2")


def test_a_homing_counts_with_the_longest_time_that_it_may_take() -> None:
    async def main(fleet: VirtualFleet) -> None:
        refused = await refusal(fleet, PREPARE)
        assert refused.code == ENDS_BEFORE and not fleet.controllers["gantry"].commanded_motions

    run_with(main, "2026-01-01T00:01:00Z", local="host-local.2")


def test_nothing_begins_after_the_end() -> None:
    async def main(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal, match=r"host-local\.2 ends at 2026-01-01 00:00:00 UTC"):
            await fleet.make_client().submit(job("[{do: enable, axes: [stage]}]"))

    run_with(main, "2026-01-01T00:00:00Z", local="host-local.2")


def test_the_certificate_of_the_coordinator_counts_for_every_job() -> None:
    async def main(fleet: VirtualFleet) -> None:
        refused = await refusal(fleet, PREPARE, LONG)
        assert refused.code == ENDS_BEFORE and refused.member is None
        assert refused.text.startswith("the coordinator: its certificate coordinator-main.1 ends at")
        with pytest.raises(Refusal, match=r"coordinator-main\.1"):
            await fleet.make_client().submit(job("[{do: dwell, duration: 400 s}]"))

    run_with(main, own="coordinator-main.1")


def test_a_renewed_certificate_counts_once_its_host_has_started_again() -> None:
    async def main(fleet: VirtualFleet) -> None:
        later = CertificateEnd(name="host-local.3", ends_utc="2026-02-01T00:00:00Z")
        fleet.certificates["local"] = later
        fleet.kill("host/local")  # which its guardian starts again
        await sleep_ns(fleet.clock, NS_PER_S)
        await fleet.wait_until(lambda states: all(each.epoch and each.mode == "idle" for each in states.values()))
        client = fleet.make_client()
        info = await client.bus.request(fleet.keys.info("gantry"), b"", 1.0)
        assert json.loads(info)["certificate"] == later.to_plain()
        assert await client.submit(FAR, terms=QueueTerms(held=True))

    run_with(main, local="host-local.2")


def test_what_has_no_certificate_states_none() -> None:
    """Messages of a fleet without keys are what they were."""

    async def main(fleet: VirtualFleet) -> None:
        info = await fleet.make_client().bus.request(fleet.keys.info("gantry"), b"", 1.0)
        assert "certificate" not in json.loads(info)
        assert await fleet.make_client().submit(FAR, terms=QueueTerms(held=True))

    run_with(main)
