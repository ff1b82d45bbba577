"""The guardian: `python -m adapters.host.guardian` with the arguments of the adapter host that it starts and watches.

When its child is dead or hung it kills it, stops the child's controllers over links of its own, and starts it again.
It imports and does as little as it can, for it must not hang itself. The child's `ready` goes to its own stdout.
"""

import argparse
import asyncio
import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from adapters.host.host import stops_by_line
from adapters.host.host_process import BAD_INPUT, BadInput, host_parser, load_host, open_sink
from adapters.link.last_stop import last_stop
from adapters.link.open import open_link
from orchestrator.bus.log import Log, Sink
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.realtime import Urgency, hurry
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.fleet import Controller

HUNG_MS = 300
FIRST_BEAT_NS = 20 * NS_PER_S
LOOK_NS = 20 * NS_PER_MS

# Where the guardian itself, and so perhaps the whole machine, was held up for longer, no more than this counts as
# silence of the child: it had no chance to beat, or its beats were not looked for.
LONGEST_LOOK_NS = 100 * NS_PER_MS

BACKOFF_FIRST_S = 0.2
BACKOFF_LONGEST_S = 5.0
HEALTHY_NS = 30 * NS_PER_S
KILL_S = 0.5
END_S = 5.0  # for the child to end when it is asked to


class Silence:
    """How long a child has not been heard, counted only while the listener itself was awake. Times in ns."""

    def __init__(self, now_ns: int) -> None:
        self._looked_ns = now_ns
        self.lasted_ns = 0

    def look(self, now_ns: int, heard: bool) -> None:
        """The listener has looked for beats, now."""
        waited_ns, self._looked_ns = now_ns - self._looked_ns, now_ns
        self.lasted_ns = 0 if heard else self.lasted_ns + min(waited_ns, LONGEST_LOOK_NS)


class Child:
    """One start of the adapter host, and the pipe that it beats on."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self.beats, beat_fd = os.pipe()
        command = [sys.executable, "-m", "adapters.host.host_process", *arguments, "--beat-fd", str(beat_fd)]
        self.process = subprocess.Popen(command, pass_fds=[beat_fd], stdin=subprocess.DEVNULL)
        os.close(beat_fd)
        os.set_blocking(self.beats, False)
        self.started_ns = raw_ns()
        self.beaten = False
        self._silence = Silence(self.started_ns)

    def trouble(self, hung_ns: int) -> str | None:
        """What is wrong with it now; None while it is well."""
        try:
            beats = os.read(self.beats, 4096)
        except BlockingIOError:
            heard = False
        else:
            if not beats:
                return f"the adapter host ended{self._code()}"
            heard = self.beaten = True
        self._silence.look(raw_ns(), heard)
        if self._silence.lasted_ns > (hung_ns if self.beaten else FIRST_BEAT_NS):
            return f"the adapter host has been silent for {self._silence.lasted_ns // NS_PER_MS} ms"
        return None

    def _code(self) -> str:
        """How it ended; it closes its pipe a moment before."""
        try:
            return f" with code {self.process.wait(KILL_S)}"
        except subprocess.TimeoutExpired:
            return ""

    def kill(self) -> None:
        """End it at once, stopped or hung as it may be, and wait until its descriptors are free."""
        self.process.kill()
        # One that hangs in the kernel can not be waited for; its controllers can be stopped all the same.
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(KILL_S)

    def close(self) -> None:
        os.close(self.beats)


class Guardian:
    """Keeps one adapter host running. `arguments` are the child's."""

    def __init__(self, arguments: Sequence[str], controllers: dict[str, Controller], hung_ns: int, log: Log) -> None:
        self._arguments = arguments
        self._controllers = controllers
        self._hung_ns = hung_ns
        self._log = log
        # Made before they are needed: what has to be imported for them might fail, or take its time.
        self._lines = stops_by_line(controllers)
        self._ended = False
        self._woken = asyncio.Event()

    def end(self) -> None:
        """Ask it to end, with its child."""
        self._ended = True
        self._woken.set()

    async def run(self) -> None:
        pause_s = BACKOFF_FIRST_S
        while not self._ended:
            child = Child(self._arguments)
            self._log.info("the adapter host is started", pid=child.process.pid)
            try:
                trouble = await self._watch(child)
                if trouble is None:
                    await self._finish(child)
                    return
                await self._take_over(child, trouble)
            finally:
                child.close()
            if raw_ns() - child.started_ns > HEALTHY_NS:
                pause_s = BACKOFF_FIRST_S
            await self._wait(pause_s)
            pause_s = min(2 * pause_s, BACKOFF_LONGEST_S)

    async def _watch(self, child: Child) -> str | None:
        """Wait for trouble; None when the guardian is asked to end."""
        loop = asyncio.get_running_loop()
        # Woken by every beat, and by the end of the pipe, which is the end of the child.
        loop.add_reader(child.beats, self._woken.set)
        try:
            while not self._ended:
                await self._wait(LOOK_NS / NS_PER_S)
                trouble = child.trouble(self._hung_ns)
                if trouble is not None:
                    return trouble
            return None
        finally:
            loop.remove_reader(child.beats)

    async def _take_over(self, child: Child, trouble: str) -> None:
        child.kill()
        self._log.info(trouble, level="error", pid=child.process.pid)
        # Before its first beat it has not touched any controller; whatever moves is then not its doing.
        if child.beaten:
            await asyncio.gather(*(self._stop(names, stop) for names, stop in self._lines))

    async def _stop(self, names: Sequence[str], stop: bytes) -> None:
        """Stop the controllers on one line, past whatever their dead drivers were saying to them."""
        clock, controller = LiveClock(), ", ".join(names)
        begun_ns = clock.now_ns()
        try:
            done = await last_stop(open_link(self._controllers[names[0]].reached_by, clock), stop, clock)
        except (LinkRefused, LinkClosed) as error:
            self._log.info(f"NOT stopped: {error}", level="error", controller=controller)
        except Exception as error:
            # A defect must keep neither the other controllers from their stop, nor the host from its successor.
            self._log.info(f"NOT stopped, by a defect: {error!r}", level="error", controller=controller)
        else:
            self._log.info(
                "stopped by the guardian",
                controller=controller,
                sent=stop.decode("latin-1"),
                answer=done.answer.decode("latin-1"),
                tries=done.tries,
                written_host_ns=done.written_ns,
                took_ms=round((done.written_ns - begun_ns) / NS_PER_MS, 3),
            )

    async def _finish(self, child: Child) -> None:
        """The child stops its controllers itself; if it does not end, it is hung."""
        child.process.terminate()
        try:
            await asyncio.to_thread(child.process.wait, END_S)
        except subprocess.TimeoutExpired:
            await self._take_over(child, f"the adapter host did not end within {END_S:g} s")
        self._log.info("the adapter host is ended")

    async def _wait(self, duration_s: float) -> None:
        """Wait, or until there is something to look at."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._woken.wait(), duration_s)
        if not self._ended:
            self._woken.clear()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until ended. Gives 0, or 2 with one line on stderr for bad input."""
    parser = host_parser(
        "python -m adapters.host.guardian", "Starts an adapter host, watches it, and takes over from it."
    )
    parser.add_argument("--hung-ms", type=int, default=HUNG_MS, help="silence after which the host counts as hung")
    parser.add_argument("--parent", type=int, help="end, with the host, when this parent process ends")
    chosen = parser.parse_args(arguments)
    try:
        _, controllers = load_host(chosen.fleet, chosen.host)
        sink = open_sink(chosen.log)
        if chosen.parent is not None:
            die_with_parent(chosen.parent)
        hurry(Urgency.GUARDIAN, children=False)
        asyncio.run(_run(chosen, controllers, sink))
    except BadInput as error:
        sys.stderr.write(f"{error}\n")
        return BAD_INPUT
    return 0


async def _run(chosen: argparse.Namespace, controllers: dict[str, Controller], sink: Sink) -> None:
    log = Log("guardian", chosen.host, LiveClock(), sink)
    guardian = Guardian(_child_arguments(chosen), controllers, chosen.hung_ms * NS_PER_MS, log)
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, guardian.end)
    await guardian.run()


def _child_arguments(chosen: argparse.Namespace) -> list[str]:
    options: dict[str, str | Path | None] = {
        "--fleet": chosen.fleet,
        "--host": chosen.host,
        "--connect": chosen.connect,
        "--state": chosen.state,
        "--log": chosen.log,
    }
    return [part for name, value in options.items() if value is not None for part in (name, str(value))]


if __name__ == "__main__":
    raise SystemExit(main())
