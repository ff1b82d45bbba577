"""What a coordinator has learned of the times of its fleet is used by the next one, as far as it still holds."""

from collections.abc import Awaitable, Callable

import pytest

from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.motion.lead_time import KNOWN_AFTER, LeadTimeEstimator
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.learned import FLEET, LearnedTimes
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

DAY_NS = 86_400 * NS_PER_S


class Fleet:
    """A fleet of three light controllers, with a client."""

    def __init__(self, virtual: VirtualFleet, tutti: Tutti) -> None:
        self.virtual, self.tutti = virtual, tutti
        self._leads = 0

    async def lead_ms(self, steps: int = 1) -> float:
        """Run steps over all axes; return the time from the arming of the last one to its T0."""
        for _ in range(steps):
            self._leads += 1
            distance = 2.0 if self._leads % 2 else -2.0
            plain = {"do": "move", "by": dict.fromkeys(self.virtual.fleet.axis_names, distance)}
            job = Job.model_validate({"schema": "tutti.job/1", "name": "own", "steps": [plain]})
            report = await (await self.tutti.submit(job)).result()
            assert report.state == "done", report.reason
        step = report.steps[0]
        assert step.t0_fleet_ns is not None and step.arming_fleet_ns is not None
        return (step.t0_fleet_ns - step.arming_fleet_ns) / 1e6

    async def replace_coordinator(self, name: str, *, kill: bool = False) -> None:
        """End the coordinator, in order or not, and start another one."""
        process, coordinator = self.virtual.coordinators["first"]
        if not kill:
            await coordinator.close()
        process.kill()
        await sleep_ns(self.virtual.clock, NS_PER_S)
        epoch = max(state.epoch for state in (await self.tutti.status()).values())
        self.virtual.start_coordinator(name)
        await self.virtual.wait_until(
            lambda states: all(state.epoch > epoch and state.mode == "idle" for state in states.values())
        )
        await self.tutti.start_queue()


def run(test: Callable[[Fleet], Awaitable[None]]) -> None:
    async def main(clock: VirtualClock) -> None:
        virtual = VirtualFleet(make_light_fleet(3, 1), clock, 1, guardian=False)
        await virtual.start()
        fleet = Fleet(virtual, virtual.make_client())
        names = list(virtual.fleet.controllers)
        steps = [{"do": "enable", "axes": names}, {"do": "home", "axes": names}]
        job = Job.model_validate({"schema": "tutti.job/1", "name": "ready", "steps": steps})
        assert (await (await fleet.tutti.submit(job)).result()).state == "done"
        await test(fleet)

    run_virtual(main)


@pytest.mark.parametrize("kill", [False, True])
def test_the_first_step_after_a_restart_leads_as_the_last_before(kill: bool) -> None:
    async def test(fleet: Fleet) -> None:
        first_ms = await fleet.lead_ms()
        learned_ms = await fleet.lead_ms(KNOWN_AFTER)
        assert learned_ms < first_ms / 2
        await sleep_ns(fleet.virtual.clock, NS_PER_S)
        await fleet.replace_coordinator("second", kill=kill)
        assert await fleet.lead_ms() <= 1.1 * learned_ms

    run(test)


@pytest.mark.parametrize("change", ["older", "another configuration", "damaged", "forgotten", "from the future"])
def test_what_does_not_hold_any_more_is_not_used(change: str) -> None:
    async def test(fleet: Fleet) -> None:
        virtual = fleet.virtual
        learned_ms = await fleet.lead_ms(KNOWN_AFTER + 1)
        if change == "forgotten":
            await fleet.tutti.forget_times()
            assert await fleet.lead_ms() > 2 * learned_ms
        await sleep_ns(virtual.clock, NS_PER_S)
        virtual.coordinators["first"][0].kill()
        store = virtual.journal.learned
        times = store.load_times()
        assert [entry.controller for entry in times] == ([] if change == "forgotten" else [FLEET, "c0", "c1", "c2"])
        if change == "older":
            virtual.clock.wall_step_ns += 31 * DAY_NS
        if change == "from the future":
            virtual.clock.wall_step_ns -= DAY_NS
        if change == "another configuration":
            store.save_times([entry.model_copy(update={"digest": "0"}) for entry in times])
        if change == "damaged":
            db = virtual.journal.database.connection
            db.execute("UPDATE learned SET body = replace(body, '0', '1')")
        await fleet.replace_coordinator("second", kill=True)
        assert await fleet.lead_ms() > 2 * learned_ms

    run(test)


def test_times_of_a_controller_are_forgotten_alone() -> None:
    async def test(fleet: Fleet) -> None:
        await fleet.lead_ms(KNOWN_AFTER + 1)
        await sleep_ns(fleet.virtual.clock, NS_PER_S)
        await fleet.tutti.forget_times("c1")
        assert [entry.controller for entry in fleet.virtual.journal.learned.load_times()] == [FLEET, "c0", "c2"]
        with pytest.raises(Refusal, match="no controller 'c9'"):
            await fleet.tutti.forget_times("c9")

    run(test)


def test_an_estimator_takes_what_another_has_listed() -> None:
    first, second = LeadTimeEstimator(), LeadTimeEstimator()
    for step in range(KNOWN_AFTER):
        first.record_arming("rest", {"a": 100}, {"a": 20 + step % 3})
        first.record_release(3_000_000, 1_000_000)
    assert first.list_shares("a") == {"rest": 0.22} and first.list_shares("b") == {}
    second.take_learned("a", first.list_shares("a"), {})
    second.take_learned(FLEET, {}, first.list_durations())
    assert second.arming_share("a") == first.arming_share("a")
    assert second.margin_ns(3) == first.margin_ns(3)
    second.forget_learned("a")
    second.forget_learned(FLEET)
    assert second.arming_share("a") == 1.0 and second.margin_ns(3) == LeadTimeEstimator().margin_ns(3)


def test_times_that_are_known_of_less_than_enough_steps_are_not_kept() -> None:
    estimator = LeadTimeEstimator()
    for _ in range(KNOWN_AFTER - 1):
        estimator.record_arming("rest", {"a": 100}, {"a": 20})
    assert estimator.list_shares("a") == {}
    utc = "2026-01-01T00:00:00Z"
    assert LearnedTimes(controller="a", digest="d", utc=utc).shares == {}
