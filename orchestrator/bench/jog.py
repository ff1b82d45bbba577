"""The reaction times of jogging on a live fleet: deceleration after a key release, or the death of the panel, and
the first motion.

Everything is real except the controllers: the panel is a process on a terminal, the bus is Zenoh, the controllers
are simulated on TCP. The motion of the axis comes from the simulator's own log.
"""

import asyncio
import contextlib
from pathlib import Path
from random import Random
from typing import NamedTuple

from orchestrator.bench.fleet import Steps, run_measured_fleet, run_steps, wait_until
from orchestrator.bench.spread import DurationSpread, WakeUpNoise, make_spread
from orchestrator.bench.truth import TruthLog
from orchestrator.client import Tutti
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.live import raw_ns
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.live.fleet import LiveFleet
from orchestrator.runtime.live.terminal_process import TerminalProcess

AXIS = "gantry.x"
MIDDLE = 150.0  # mm: presses move a few mm to and fro around it
SPEED = 10.0  # mm/s: the panel's initial speed
RELEASE_P99_MS = 60.0
KILLED_MAX_MS = 300.0
HELD_S = (0.15, 0.5)  # shorter than the permitted silence of a terminal
REPEAT_S, REPEAT_DELAY_S = 1 / 30, 0.3
SEED = 11


class JogFigures(NamedTuple):
    """The figures of all presses.

    release: key released → deceleration.
    killed: `kill -9` of the panel → deceleration.
    first_motion: key pressed → motion.
    plain_release: `release` on a terminal that only repeats, at 30 Hz.
    api_stop: `ManualControl.stop` in this process → deceleration, without panel and terminal.
    noise: wake-up delay of this process during the run.
    """

    release: DurationSpread
    killed: DurationSpread
    first_motion: DurationSpread
    plain_release: DurationSpread
    api_stop: DurationSpread
    noise: DurationSpread


class _JogRig:
    """The running fleet. `panel_code`: the panel's command line as a Python program."""

    def __init__(self, live: LiveFleet, tutti: Tutti, panel_code: str) -> None:
        self._live = live
        self._code = panel_code
        self._draw = Random(SEED)
        self._arrow = "left"
        self.tutti = tutti
        self.truth = TruthLog(live.state / "truth" / "gantry.jsonl")

    async def start_panel(self, *, releases: bool) -> TerminalProcess:
        """Start a new panel and wait until it is ready, with the axis not leased."""
        await wait_until(self._is_axis_free, "the axis is free")
        arguments = ["axis", "jog", AXIS, "--connect", self._live.connect]
        panel = TerminalProcess(self._code, arguments, releases=releases)

        async def is_panel_ready() -> bool:
            return "motor" in panel.screen_text and " on " in panel.screen_text

        await wait_until(is_panel_ready, "the panel is ready")
        return panel

    def next_arrow(self) -> str:
        """Return the other arrow."""
        self._arrow = "right" if self._arrow == "left" else "left"
        return self._arrow

    async def keep_pressed(self) -> None:
        """Keep a key pressed for a while."""
        await asyncio.sleep(self._draw.uniform(*HELD_S))

    def draw_part(self, duration_s: float) -> float:
        """Draw a part of `duration_s`, in s."""
        return self._draw.uniform(0, duration_s)

    async def _is_axis_free(self) -> bool:
        return not (await self.tutti.status())["gantry"].leases


async def bench_jog(fleet: Fleet, state: Path, panel_code: str, presses: int, kills: int) -> JogFigures:
    """Run all measurements. Raises `UpFailed`, `Refusal`, `NothingHappened`."""
    async with run_measured_fleet(fleet, state) as (live, tutti), WakeUpNoise() as noise:
        first_steps: Steps = [{"do": "enable", "axes": ["gantry"]}, {"do": "home", "axes": ["gantry"]}]
        await run_steps(tutti, [*first_steps, {"do": "move", "to": {AXIS: MIDDLE}}])
        rig = _JogRig(live, tutti, panel_code)
        first_ns, release_ns = await _measure_presses(rig, presses)
        killed_ns = [await _measure_kill(rig) for _ in range(kills)]
        plain_ns = await _measure_plain(rig, max(1, presses // 4))  # each takes two seconds
        api_ns = await _measure_api(rig, presses)
        return JogFigures(
            release=make_spread(release_ns, p99_ms=RELEASE_P99_MS),
            killed=make_spread(killed_ns, max_ms=KILLED_MAX_MS),
            first_motion=make_spread(first_ns),
            plain_release=make_spread(plain_ns),
            api_stop=make_spread(api_ns),
            noise=noise.make_spread(),
        )


async def _measure_presses(rig: _JogRig, count: int) -> tuple[list[int], list[int]]:
    """Measure press to motion, and release to deceleration, for `count` presses on one panel."""
    first_ns: list[int] = []
    release_ns: list[int] = []
    with contextlib.closing(await rig.start_panel(releases=True)) as panel:
        for _ in range(count):
            arrow = rig.next_arrow()
            pressed_ns = panel.press_arrow(arrow)
            first_ns.append(await rig.truth.wait_for_event("start", pressed_ns) - pressed_ns)
            await rig.keep_pressed()
            let_go_ns = panel.release_arrow(arrow)
            release_ns.append(await rig.truth.wait_for_event("slowing", let_go_ns) - let_go_ns)
            await rig.truth.wait_for_event("end", let_go_ns)
    return first_ns, release_ns


async def _measure_kill(rig: _JogRig) -> int:
    with contextlib.closing(await rig.start_panel(releases=True)) as panel:
        pressed_ns = panel.press_arrow(rig.next_arrow())
        await rig.truth.wait_for_event("start", pressed_ns)
        await rig.keep_pressed()
        killed_ns = panel.kill()
        slowing_ns = await rig.truth.wait_for_event("slowing", killed_ns)
        await rig.truth.wait_for_event("end", killed_ns)
    return slowing_ns - killed_ns


async def _measure_plain(rig: _JogRig, count: int) -> list[int]:
    """Measure the same with key repeats only: the key is released at some time between two repeats, without an
    event."""
    durations_ns: list[int] = []
    with contextlib.closing(await rig.start_panel(releases=False)) as panel:
        for _ in range(count):
            arrow = rig.next_arrow()
            pressed_ns = panel.press_arrow(arrow)
            await asyncio.sleep(REPEAT_DELAY_S)
            repeated_ns = panel.repeat_arrow(arrow)
            await rig.truth.wait_for_event("start", max(pressed_ns, repeated_ns - 50 * NS_PER_MS))
            for _ in range(8):
                await asyncio.sleep(REPEAT_S)
                panel.repeat_arrow(arrow)
            await asyncio.sleep(rig.draw_part(REPEAT_S))
            let_go_ns = raw_ns()
            durations_ns.append(await rig.truth.wait_for_event("slowing", let_go_ns) - let_go_ns)
            await rig.truth.wait_for_event("end", let_go_ns)
            # Otherwise the next press would count as one more repeat.
            await asyncio.sleep(1.0)
    return durations_ns


async def _measure_api(rig: _JogRig, count: int) -> list[int]:
    durations_ns: list[int] = []
    async with rig.tutti.manual_control([AXIS], what="benchmark") as hand:
        for _ in range(count):
            velocity = SPEED if rig.next_arrow() == "right" else -SPEED
            asked_ns = raw_ns()
            await hand.jog({AXIS: velocity})
            await rig.truth.wait_for_event("start", asked_ns)
            await hand.renew_jog()
            stopped_ns = raw_ns()
            await hand.stop()
            durations_ns.append(await rig.truth.wait_for_event("slowing", stopped_ns) - stopped_ns)
            await rig.truth.wait_for_event("end", stopped_ns)
    return durations_ns
