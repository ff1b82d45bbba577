"""The time from the loss of a permit to the deceleration of the last axis of a step, on a live fleet of eight
controllers.

An input of one controller changes; its adapter must detect that, the coordinator must receive it, and all adapters
must stop their controllers, which are simulated on TCP and record their motions.
"""

import asyncio
from pathlib import Path
from random import Random
from typing import NamedTuple

from orchestrator.bench.fleet import run_measured_fleet, run_steps, submit_steps, wait_until
from orchestrator.bench.spread import DurationSpread, WakeUpNoise, make_spread
from orchestrator.bench.truth import TruthLog
from orchestrator.clock.live import raw_ns
from orchestrator.model.fleet import Controller, Fleet, Permit
from orchestrator.model.links import TcpLink

CONTROLLERS = 8
PERMIT = "door-closed"
MIDDLE, DISTANCE = 150.0, 100.0  # mm: a step to and fro, 10 s long at its speed, of which only a small part is executed
SPEED = 0.05
BEYOND_POLL_MS = 50.0
MOVING_S = (0.3, 1.0)  # from the first motion to the loss, so that losses fall at any phase of a poll interval
SEED = 12


class PermitFigures(NamedTuple):
    """The figures of all rounds.

    stopped: input changed → the last of all axes decelerates.
    first: the same, the first of them.
    poll_ms: poll interval of a moving controller, `state.moving_hz` of the fleet file.
    """

    controllers: int
    poll_ms: float
    stopped: DurationSpread
    first: DurationSpread
    noise: DurationSpread


def make_permit_fleet(gantry: Controller, count: int) -> Fleet:
    """Return `count` controllers like `gantry` with the first of its axes, and a permit on an input of the first
    one."""
    axis, input_ = next(iter(gantry.axes)), next(iter(gantry.inputs))
    controllers = {
        f"g{k}": gantry.model_copy(
            update={"link": TcpLink(host="127.0.0.1", port=k), "axes": {axis: gantry.axes[axis]}}
        )
        for k in range(1, count + 1)
    }
    permits = {PERMIT: Permit(input=f"g1.{input_}", value=False)}
    return Fleet(schema="tutti.fleet/1", fleet="permit", controllers=controllers, permits=permits)


async def bench_permit(gantry: Controller, state: Path, rounds: int) -> PermitFigures:
    """Lose the permit `rounds` times in a slow step over all axes. Raises `UpFailed`, `Refusal`, `NothingHappened`."""
    fleet, draw = make_permit_fleet(gantry, CONTROLLERS), Random(SEED)
    number = next(iter(gantry.inputs.values())).number
    first_ns: list[int] = []
    last_ns: list[int] = []
    async with run_measured_fleet(fleet, state) as (live, tutti), WakeUpNoise() as noise:
        axes = list(fleet.controllers)
        middle = dict.fromkeys(fleet.axis_names, MIDDLE)
        await run_steps(tutti, [{"do": "enable", "axes": axes}, {"do": "home"}, {"do": "move", "to": middle}])
        truths = [TruthLog(live.state / "truth" / f"{name}.jsonl") for name in axes]
        for k in range(rounds):
            began_ns = raw_ns()
            by = dict.fromkeys(fleet.axis_names, -DISTANCE if k % 2 else DISTANCE)
            job = await submit_steps(tutti, [{"do": "move", "by": by, "speed": SPEED}])
            await asyncio.gather(*(truth.wait_for_event("start", began_ns) for truth in truths))
            await asyncio.sleep(draw.uniform(*MOVING_S))
            lost_ns = raw_ns()
            live.change_simulation("g1", input=(number, False))
            slowing_ns = await asyncio.gather(*(truth.wait_for_event("slowing", lost_ns) for truth in truths))
            first_ns.append(min(slowing_ns) - lost_ns)
            last_ns.append(max(slowing_ns) - lost_ns)
            await tutti.wait_for_job(job, poll_s=0.1)
            live.change_simulation("g1", input=(number, True))

            async def is_permit_restored() -> bool:
                states = (await tutti.status()).values()
                return all(state.mode == "idle" and not any(state.inputs.values()) for state in states)

            await wait_until(is_permit_restored, "the permit is restored")
        poll_ms = 1000 / gantry.state.moving_hz
        return PermitFigures(
            controllers=len(axes),
            poll_ms=poll_ms,
            stopped=make_spread(last_ns, max_ms=BEYOND_POLL_MS + poll_ms),
            first=make_spread(first_ns),
            noise=noise.make_spread(),
        )
