"""Measures the gateway and the page: processor time, script time, heap, and how quickly a jog ends."""

import asyncio
import contextlib
import gzip
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from random import Random
from statistics import median
from typing import Any, NamedTuple

import websockets
from playwright.async_api import Page, Route, WebSocketRoute

from benches.page.browser import PageInBrowser, open_browser
from benches.page.frames import HELLO, make_frames
from orchestrator.bench.fleet import Steps, run_measured_fleet, run_steps, wait_until
from orchestrator.bench.processes import read_cpu_s
from orchestrator.bench.recording.measure import start_part
from orchestrator.bench.truth import NothingHappened, TruthLog
from orchestrator.clock.live import raw_ns
from orchestrator.gateway.app import PAGE
from orchestrator.gateway.stream.stream_view import encode
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.live.fleet import LiveFleet, find_free_port
from orchestrator.runtime.live.run import WebOptions

FLEET, CONTROLLERS, HZ, SOCKETS = "bench", 16, 20.0, 20
CPU_SHARE, SCRIPT_MS, HEAP_MB, FILES_KB = 0.10, 5.0, 1.0, 90.0
WARM, FED = 2000, 12_000
DIFFERENT_FRAMES, FRAMES_AT_ONCE = 200, 100
LET_GO_MS, SILENT_MS = 80.0, 300.0  # the adapter's 200 ms, the latency of its stop, and one poll
END_JOGS, END_JOG_CPU_MS = 300, 5.0
AXIS, MIDDLE = "gantry.x", 150.0
SEED = 5


class PageFigure(NamedTuple):
    """One figure with its target."""

    what: str
    value: float
    asked: str
    met: bool


async def bench_page(
    fleet: Fleet, folder: Path, seconds: float, rounds: int, show_progress: Callable[[str], None]
) -> list[PageFigure]:
    """Measure. fleet: with `gantry.x`, for the jogs. Raises `NothingHappened`, `UpFailed`, `Refusal`."""
    if not (PAGE / "page.js").is_file():
        raise NothingHappened("the page is not built; build it: make page")
    size_kb = sum(len(gzip.compress(path.read_bytes(), 9)) for path in PAGE.iterdir()) / 1000
    figures = [_at_most("built files, kB gzipped", size_kb, FILES_KB)]
    show_progress(f"{SOCKETS} sockets and a page, {4 * CONTROLLERS} axes, {seconds:g} s")
    figures += await _measure_load(folder / "load", seconds)
    show_progress(f"{FED} updates as fast as they go")
    figures += await _measure_updates()
    show_progress(f"{rounds} jogs")
    return figures + await _measure_jogs(fleet, folder / "jogs", rounds)


def _at_most(what: str, value: float, most: float) -> PageFigure:
    return PageFigure(what, round(value, 3), f"<= {most:g}", value <= most)


# The gateway's processor time


async def _measure_load(folder: Path, seconds: float) -> list[PageFigure]:
    folder.mkdir(parents=True)
    endpoint, port = f"tcp/127.0.0.1:{find_free_port()}", find_free_port()
    router = await start_part("orchestrator.bus.zenoh.router", endpoint, str(os.getpid()))
    options = ["--fleet", FLEET, "--connect", endpoint, "--state", str(folder), "--log", str(folder / "log")]
    gateway = await start_part("orchestrator.gateway.process", *options, "--port", str(port))
    page = f"http://127.0.0.1:{port}/"
    readers = [asyncio.create_task(_read_stream(port)) for _ in range(SOCKETS)]
    try:
        async with open_browser() as browser:
            module = "orchestrator.bench.recording.publisher"
            arguments = [endpoint, FLEET, str(CONTROLLERS), f"{HZ}", f"{seconds + 5}", "4"]
            publisher = await asyncio.create_subprocess_exec(
                sys.executable, "-m", module, *arguments, stdout=asyncio.subprocess.PIPE
            )
            await browser.page.goto(page)
            await browser.page.get_by_test_id("axis-c00.x").wait_for()
            await asyncio.sleep(2.0)
            begin_s, script_s = read_cpu_s(gateway.pid), await browser.read_script_s()
            updates = await _count_updates(browser.page)
            await asyncio.sleep(seconds)
            cpu_s = read_cpu_s(gateway.pid) - begin_s
            update_count = await _count_updates(browser.page) - updates
            script_ms = (await browser.read_script_s() - script_s) * 1e3 / max(1, update_count)
            await publisher.communicate()
            requests, sockets = browser.first_requests or 0, browser.sockets
        if any(task.done() for task in readers):
            raise NothingHappened("a socket was disconnected")
    finally:
        for reader in readers:
            reader.cancel()
        for process in (gateway, router):
            process.terminate()
            await process.wait()
    return [
        _at_most("gateway's processor time, % of one", cpu_s / seconds * 100, CPU_SHARE * 100),
        PageFigure(
            "updates of the page a second", round(update_count / seconds, 1), "<= 20", update_count / seconds <= 20.5
        ),
        _at_most("script time an update, live, ms", script_ms, SCRIPT_MS),
        _at_most("requests until the first data", requests, 3),
        _at_most("sockets", sockets, 1),
    ]


async def _read_stream(port: int) -> None:
    async with websockets.connect(f"ws://127.0.0.1:{port}/v1/stream", max_size=None) as stream:
        async for _ in stream:
            pass


async def _count_updates(page: Page) -> int:
    return await page.evaluate("window.tutti.updates")


# The page's script time and heap

_FEED = """async ([frames, first, count, atOnce]) => {
    for (let at = 0; at < count; at += 1) {
        window.tutti.feed(`{"n":${first + at},${frames[at % frames.length]}}`);
        if (at % atOnce === atOnce - 1) await new Promise((done) => setTimeout(done));
    }
}"""


async def _measure_updates() -> list[PageFigure]:
    """Feed differences by the way that frames of the socket take; the socket itself stays silent."""
    state, patches = make_frames(FLEET, CONTROLLERS, DIFFERENT_FRAMES)
    async with open_browser() as browser:
        page = browser.page

        async def serve_file(route: Route) -> None:
            path = PAGE / (route.request.url.rpartition("/")[2] or "index.html")
            await (route.fulfill(path=path) if path.is_file() else route.fulfill(status=503, json={}))

        def keep_socket(socket: WebSocketRoute) -> None:
            socket.send(json.dumps({"hello": HELLO}))
            socket.send(f'{{"n":0,{state}}}')

        await page.route("http://page.test/**", serve_file)
        await page.route_web_socket("**/v1/stream*", keep_socket)
        await page.goto("http://page.test/")
        await page.get_by_test_id("axis-c00.x").wait_for()
        await page.evaluate(_FEED, [patches, 1, WARM, FRAMES_AT_ONCE])
        heap = await browser.read_heap_bytes()
        script_s = await browser.read_script_s()
        await page.evaluate(_FEED, [patches, WARM + 1, FED - WARM, FRAMES_AT_ONCE])
        script_ms = (await browser.read_script_s() - script_s) * 1e3 / (FED - WARM)
        grown_mb = (await browser.read_heap_bytes() - heap) / 1e6
        update_count = await _count_updates(page)
    if update_count < FED:
        raise NothingHappened(f"the page has taken {update_count} of {FED} updates")
    return [
        _at_most("script time an update, ms", script_ms, SCRIPT_MS),
        _at_most(f"heap from {WARM} to {FED} updates, MB", grown_mb, HEAP_MB),
    ]


# Jogs


async def _measure_jogs(fleet: Fleet, folder: Path, rounds: int) -> list[PageFigure]:
    web = WebOptions(port=find_free_port())
    async with run_measured_fleet(fleet, folder, web=web) as (live, tutti):
        first_steps: Steps = [{"do": "enable", "axes": ["gantry"]}, {"do": "home", "axes": ["gantry"]}]
        await run_steps(tutti, [*first_steps, {"do": "move", "to": {AXIS: MIDDLE}}])
        truth = TruthLog(live.state / "truth" / "gantry.jsonl")
        async with open_browser() as browser:
            let_go_ns = [await _let_go(browser, live, truth, number) for number in range(rounds)]
        killed_ns = [await _kill_browser(live, truth, number) for number in range(max(1, rounds // 10))]
        cpu_ms = await _measure_end_jogs(live)
    return [
        _at_most("jog let go to decelerating, median, ms", median(let_go_ns) / 1e6, LET_GO_MS),
        _at_most("browser killed to decelerating, most, ms", max(killed_ns) / 1e6, SILENT_MS),
        _at_most("gateway's processor time for the end of a jog, ms", cpu_ms, END_JOG_CPU_MS),
    ]


async def _let_go(browser: PageInBrowser, live: LiveFleet, truth: TruthLog, number: int) -> int:
    """Hold a jog button and let it go; the time until the axis slows down, with that of the browser, ns."""
    page = browser.page
    if not number:
        await page.goto(f"{live.page}#setup")
    await _press_jog(page, truth, number)
    asked_ns = raw_ns()
    await page.mouse.up()
    slowing_ns = await truth.wait_for_event("slowing", asked_ns)
    await truth.wait_for_event("end", asked_ns)
    return slowing_ns - asked_ns


async def _press_jog(page: Page, truth: TruthLog, number: int) -> None:
    """Press a jog button, to one side and the other in turn, and keep it down for a while; the axis moves then."""
    button = page.get_by_role("button", name=f"Jog {AXIS} {'+' if number % 2 else '−'}", exact=True)
    await button.wait_for()
    await wait_until(lambda: _is_enabled(page, number), "the jog button is enabled")
    box = await button.bounding_box()
    assert box is not None
    await page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    pressed_ns = raw_ns()
    await page.mouse.down()
    await truth.wait_for_event("start", pressed_ns)
    await asyncio.sleep(Random(SEED + number).uniform(0.15, 0.6))


async def _is_enabled(page: Page, number: int) -> bool:
    button = page.get_by_role("button", name=f"Jog {AXIS} {'+' if number % 2 else '−'}", exact=True)
    return await button.get_attribute("aria-disabled") is None


async def _kill_browser(live: LiveFleet, truth: TruthLog, number: int) -> int:
    """Kill the browser in mid-jog, every second time only stop it, so that its socket stays open; as above."""
    with contextlib.suppress(Exception):  # the browser is gone
        async with open_browser() as browser:
            await browser.page.goto(f"{live.page}#setup")
            await _press_jog(browser.page, truth, number)
            family = _find_family(browser.pid)
            asked_ns = raw_ns()
            for pid in family:
                os.kill(pid, signal.SIGSTOP if number % 2 else signal.SIGKILL)
            try:
                slowing_ns = await truth.wait_for_event("slowing", asked_ns)
                await truth.wait_for_event("end", asked_ns)
            finally:
                for pid in family if number % 2 else ():
                    os.kill(pid, signal.SIGKILL)
            return slowing_ns - asked_ns
    raise NothingHappened("the axis did not stop")


def _find_family(pid: int) -> list[int]:
    """A process and all its descendants."""
    family = [pid]
    for parent in family:
        for task in Path(f"/proc/{parent}/task").glob("*/children"):
            family += map(int, task.read_text(encoding="utf-8").split())
    return family


async def _measure_end_jogs(live: LiveFleet) -> float:
    """The gateway's processor time for the end of a jog, ms, beyond what it takes anyway."""
    child = live.children["gateway"]
    address = live.page.replace("http", "ws", 1)
    async with websockets.connect(f"{address}v1/stream", max_size=None) as stream:

        async def ask(number: int, **fields: Any) -> None:
            await stream.send(encode({"id": number, **fields}))
            while json.loads(await stream.recv()).get("answer") != number:
                pass

        await ask(1, do="acquire", axes=[AXIS])
        await ask(2, do="jog", axis=AXIS, velocity=1.0)
        spent_s: list[float] = []
        for frame in ({"do": "alive"}, {"do": "end-jog"}):
            begin_s, began_ns = read_cpu_s(child.pid), raw_ns()
            for _ in range(END_JOGS):
                await stream.send(encode(frame))
                await asyncio.sleep(0.01)
            spent_s.append((read_cpu_s(child.pid) - begin_s) / (raw_ns() - began_ns) * 1e9)
            await ask(3, do="renew") if frame["do"] == "alive" else None
        return max(0.0, (spent_s[1] - spent_s[0]) * 10.0)
