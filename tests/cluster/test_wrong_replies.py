"""The way back from wrong replies: from the first right one to a state that is right, and to a link that is of use."""

import asyncio
import re
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

import pytest
from cluster.worlds import EXAMPLES, job, line_fleet, origin_host_ns, outcome, run_fleet

from orchestrator.bus.base import BusSample
from orchestrator.campaign.injection.arbitrary_replies import ArbitraryReplies
from orchestrator.clock.base import NS_PER_S
from orchestrator.conformance.examples import make_case
from orchestrator.model.fleet import Fleet
from orchestrator.model.state import ControllerState
from orchestrator.runtime.virtual.fleet import VirtualFleet

WRONG_S = 3.0
STAYS_S = 1.0  # a state that is right for this long stays so
POSITION_COUNTS = 5  # an encoder at rest


@dataclass(frozen=True)
class WayBack:
    """axis: of the fleet, whose controller answers wrongly. target: of its motion, in its unit. longest_s: of the way
    back; `why`, where it is more than a second. The pause between two attempts is up to 0.4 s of it."""

    axis: str
    target: float
    longest_s: float = 1.0
    why: str = ""

    @property
    def controller(self) -> str:
        return self.axis.partition(".")[0]


WAYS_BACK = {
    "smc4000": WayBack("gantry.x", 300, 1.3, "an attempt under way waits half a second for a reply that was wrong"),
    "galil": WayBack("galil.x", 300, 1.3, "as for an SMC-4000"),
    "smc2000": WayBack("feeder.x", 150, 5.5, "at 19,200 baud to connect takes 5.0 s, though nothing is wrong"),
    "shrc203": WayBack("stage.u", 40, 1.5, "it is asked twice, each time for `answer_ms` (0.5 s)"),
    "ppsmc": WayBack("table.turn", 150, 2.7, "`answer_ms` is 1 s; then it is asked as one that is blocked, as long"),
    "smc30": WayBack("lift.z", 80),
    "cia402": WayBack("arm.r", 150),
    "ascii": WayBack("ascii.x", -150, 1.9, "an attempt under way waits for `answer_ms` (0.5 s), twice for a status"),
}


def make_fleet(make: str) -> Fleet:
    if make not in ("galil", "ascii"):
        return line_fleet(WAYS_BACK[make].controller)
    case = make_case(make)
    plain = case.controller.model_dump(mode="json", by_alias=True, exclude_none=True)
    plain["simulate"] = {"options": dict(case.simulate)}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "one", "controllers": {make: plain}})


def make_wrong(draw: Random, *, can: bool) -> Callable[[bytes], bytes]:
    """What arrives instead of replies. Of the same length: longer ones would arrive long after they were right again."""
    if can:  # wrong frames; corrupted ones are not delivered
        return ArbitraryReplies(draw).change_frames
    return lambda data: draw.randbytes(len(data))


@dataclass
class StateWatch:
    """Compares the published states with the simulated controller. right_ns: since when they are right; None: the last
    one is not. since_ns: a state of a poll before that is old."""

    fleet: VirtualFleet
    make: str
    origin_ns: int
    since_ns: int = 0
    right_ns: int | None = None

    def take_sample(self, sample: BusSample) -> None:
        state = ControllerState.read_message(sample.payload)
        if state.controller != WAYS_BACK[self.make].controller:
            return
        if not self._is_right(state):
            self.right_ns = None
        elif self.right_ns is None:
            self.right_ns = self.fleet.clock.now_ns()

    def _is_right(self, state: ControllerState) -> bool:
        if state.mode == "offline" or (state.read_fleet_ns or 0) + self.origin_ns < self.since_ns:
            return False
        unit = self.fleet.controllers[state.controller]
        config = self.fleet.fleet.controllers[state.controller]
        motors = {name: axis.motors[0] for name, axis in config.axes.items()}
        if any(axis.moving for axis in state.axes.values()) != any(map(unit.is_moving, motors.values())):
            return False
        return all(
            axis.moving or abs(axis.raw_counts - unit.position(motors[name])) <= POSITION_COUNTS
            for name, axis in state.axes.items()
        )


def measure_way_back(make: str, *, moves: bool) -> float:
    """The time from the first right reply to a right state, s."""
    way = WAYS_BACK[make]
    whole_fleet = make_fleet(make)

    async def main(fleet: VirtualFleet) -> float:
        client = fleet.make_client()
        prepare = job(f"[{{do: enable, axes: [{way.controller}]}}, {{do: home, axes: [{way.controller}]}}]")
        assert (await outcome(fleet, prepare)).state == "done"
        if moves:
            await client.submit(job(f"[{{do: move, to: {{{way.axis}: {way.target}}}, speed: 0.2}}]"))
            await fleet.wait_until(lambda states: states[way.controller].mode == "moving")
        await asyncio.sleep(0.5)
        watch = StateWatch(fleet, make, origin_host_ns(fleet))
        await client.bus.subscribe(fleet.keys.state(way.controller), watch.take_sample)
        wire = fleet.wires[way.controller]
        wire.to_near = make_wrong(Random(1), can=whole_fleet.controllers[way.controller].link.kind == "can")
        await asyncio.sleep(WRONG_S)
        wire.to_near, watch.since_ns, watch.right_ns = None, fleet.clock.now_ns(), None
        async with asyncio.timeout(60):
            while watch.right_ns is None or fleet.clock.now_ns() < watch.right_ns + STAYS_S * NS_PER_S:
                await asyncio.sleep(0.1)
        right_ns = watch.right_ns
        assert not any((await client.reset()).values())  # the link is of use
        return (right_ns - watch.since_ns) / NS_PER_S

    return run_fleet(main, whole_fleet)


@pytest.mark.parametrize("make", WAYS_BACK)
def test_a_state_is_right_soon_after_wrong_replies_have_ended(make: str) -> None:
    way = WAYS_BACK[make]
    assert bool(way.why) is (way.longest_s > 1.0)
    took_s = [measure_way_back(make, moves=moves) for moves in (False, True)]
    assert max(took_s) <= way.longest_s, took_s


def test_the_page_of_failures_has_each_make_with_its_bound() -> None:
    page = (EXAMPLES.parents[1] / "docs" / "explanation" / "failures.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| (\w+) \|[^|]*\|[^|]*\| ([\d.]+ \| .*) \|$", page, re.MULTILINE))
    assert rows == {make: f"{way.longest_s} | {way.why or '–'}" for make, way in WAYS_BACK.items()}
