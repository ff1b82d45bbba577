"""The guardian: `python -m adapters.host.guardian` with the arguments of the adapter host that it starts and watches.

When its child is dead or hung, it kills the child, stops the child's controllers over links of its own, and starts the
child again. It also keeps the e-stop latch for the child, which receives no e-stop while it restarts. It does as little
as possible, because it must not hang itself. The child's `ready` goes to the child's own stdout.
"""

import argparse
import asyncio
import contextlib
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from adapters.host.host_process import BAD_INPUT, InvalidInput, host_parser, load_host, open_sink
from adapters.host.makes import stops_by_line
from adapters.host.slow_starts import SupervisedStarts
from adapters.link.last_stop import send_last_stop
from adapters.link.open import make_link_opener
from orchestrator.bus.log import LogSink, ProcessLog
from orchestrator.bus.zenoh.kept_latch import keep_latch
from orchestrator.bus.zenoh.patience import announce_slow_start
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.parent import die_with_parent
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority
from orchestrator.clock.service_manager import ServiceManager
from orchestrator.clock.signals import call_at_signals
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.fleet import Controller

HUNG_MS = 300
CHECK_NS = 20 * NS_PER_MS

# If the guardian itself, and so perhaps the whole machine, was suspended for longer, no more than this counts as
# silence of the child: the child could not send heartbeats, or they were not read.
LONGEST_CHECK_NS = 100 * NS_PER_MS

BACKOFF_FIRST_S = 0.2
BACKOFF_LONGEST_S = 5.0
HEALTHY_NS = 30 * NS_PER_S
CHILD_KILL_S = 0.5
CHILD_END_S = 5.0  # for the child to end after a request


class SilenceTimer:
    """Duration of a child's silence, counted only while the guardian itself was running. Times in ns."""

    def __init__(self, now_ns: int) -> None:
        self._checked_ns = now_ns
        self.lasted_ns = 0

    def record_check(self, now_ns: int, *, heartbeat_seen: bool) -> None:
        """Record a check for heartbeats at `now_ns`."""
        waited_ns, self._checked_ns = now_ns - self._checked_ns, now_ns
        self.lasted_ns = 0 if heartbeat_seen else self.lasted_ns + min(waited_ns, LONGEST_CHECK_NS)


class HostChild:
    """One run of the adapter host, and the pipe of its heartbeats."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self.heartbeats, beat_fd = os.pipe()
        command = [sys.executable, "-m", "adapters.host.host_process", *arguments, "--beat-fd", str(beat_fd)]
        self.process = subprocess.Popen(command, pass_fds=[beat_fd], stdin=subprocess.DEVNULL)
        os.close(beat_fd)
        os.set_blocking(self.heartbeats, False)
        self.started_ns = raw_ns()
        self.needed_ns: int | None = None
        """From its start to its first heartbeat."""
        self._silence = SilenceTimer(self.started_ns)

    @property
    def has_beaten(self) -> bool:
        """Whether it has started, and may access controllers."""
        return self.needed_ns is not None

    def find_failure(self, hung_ns: int, first_ns: int) -> str | None:
        """Return the failure of the child; None while it is healthy. hung_ns, first_ns: the longest silence, and that
        before the first heartbeat."""
        try:
            beats = os.read(self.heartbeats, 4096)
        except BlockingIOError:
            is_beating = False
        else:
            if not beats:
                return f"the adapter host ended{self._exit_code_text()}"
            is_beating = True
            if self.needed_ns is None:
                self.needed_ns = raw_ns() - self.started_ns
        self._silence.record_check(raw_ns(), heartbeat_seen=is_beating)
        if self._silence.lasted_ns > (hung_ns if self.has_beaten else first_ns):
            return f"the adapter host has been silent for {self._silence.lasted_ns // NS_PER_MS} ms"
        return None

    def _exit_code_text(self) -> str:
        """Return the exit code as text; the pipe closes a moment before the process ends."""
        try:
            return f" with code {self.process.wait(CHILD_KILL_S)}"
        except subprocess.TimeoutExpired:
            return ""

    def kill(self) -> None:
        """Kill the child, stopped or hung as it may be, and wait until its descriptors are closed."""
        self.process.kill()
        # A child that hangs in the kernel cannot be reaped; its controllers can be stopped all the same.
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(CHILD_KILL_S)

    def close(self) -> None:
        os.close(self.heartbeats)


class HostGuardian:
    """Keep one adapter host running. `arguments` are the child's; starts: the limits of its starts."""

    def __init__(
        self,
        arguments: Sequence[str],
        controllers: dict[str, Controller],
        hung_ns: int,
        log: ProcessLog,
        starts: SupervisedStarts,
    ) -> None:
        self._arguments = arguments
        self._controllers = controllers
        self._hung_ns = hung_ns
        self._log = log
        self._starts = starts
        # Created before they are needed: their imports could fail, or take time.
        # A controller in the process of its adapter has ended with that.
        other_controllers = {name: config for name, config in controllers.items() if config.link.kind != "process"}
        self._lines = stops_by_line(other_controllers)
        self._ended = False
        self._woken = asyncio.Event()
        self.checks = 0
        """How often the child was found healthy."""

    def request_end(self) -> None:
        """Request the guardian and its child to end."""
        self._ended = True
        self._woken.set()

    async def run(self) -> None:
        pause_s = BACKOFF_FIRST_S
        while not self._ended:
            child = HostChild(self._arguments)
            self._log.info("the adapter host is started", pid=child.process.pid)
            try:
                trouble = await self._watch_child(child)
                if trouble is None:
                    await self._end_child(child)
                    return
                await self._take_over(child, trouble)
            finally:
                child.close()
            if raw_ns() - child.started_ns > HEALTHY_NS:
                pause_s = BACKOFF_FIRST_S
            await self._wait_or_wake(pause_s)
            pause_s = min(2 * pause_s, BACKOFF_LONGEST_S)

    async def _watch_child(self, child: HostChild) -> str | None:
        """Wait for a failure of the child; None when the guardian is requested to end."""
        loop = asyncio.get_running_loop()
        # Woken by every heartbeat, and by the end of the pipe, which is the end of the child.
        loop.add_reader(child.heartbeats, self._woken.set)
        try:
            while not self._ended:
                await self._wait_or_wake(CHECK_NS / NS_PER_S)
                trouble = child.find_failure(self._hung_ns, self._starts.limit_ns)
                if trouble is not None:
                    return trouble
                self._starts.take_look(child.needed_ns, raw_ns() - child.started_ns)
                self.checks += 1
            return None
        finally:
            loop.remove_reader(child.heartbeats)

    async def _take_over(self, child: HostChild, trouble: str) -> None:
        if not child.has_beaten and child.process.poll() is None:
            trouble += self._starts.note_killed()
        else:
            self._starts.note_ended()
        child.kill()
        self._log.info(trouble, level="error", pid=child.process.pid)
        # Before its first heartbeat the child has not accessed any controller; no motion is caused by it.
        if child.has_beaten:
            await asyncio.gather(*(self._stop_controllers(names, stop) for names, stop in self._lines))

    async def _stop_controllers(self, names: Sequence[str], stop: bytes) -> None:
        """Stop the controllers on one line, regardless of half-sent commands of their dead drivers."""
        clock, controller = LiveClock(), ", ".join(names)
        begun_ns = clock.now_ns()
        try:
            outcome = await send_last_stop(
                make_link_opener(self._controllers[names[0]].link_to_open, clock), stop, clock
            )
        except (LinkRefused, LinkClosed) as error:
            self._log.info(f"NOT stopped: {error}", level="error", controller=controller)
        except Exception as error:
            # A defect must not prevent the stop of the other controllers or the restart of the host.
            self._log.info(f"NOT stopped, because of a defect: {error!r}", level="error", controller=controller)
        else:
            self._log.info(
                "stopped by the guardian",
                controller=controller,
                sent=stop.decode("latin-1"),
                answer=outcome.answer.decode("latin-1"),
                tries=outcome.tries,
                written_host_ns=outcome.written_ns,
                took_ms=round((outcome.written_ns - begun_ns) / NS_PER_MS, 3),
            )

    async def _end_child(self, child: HostChild) -> None:
        """Let the child end: it stops its controllers itself; if it does not end, it is hung."""
        child.process.terminate()
        try:
            await asyncio.to_thread(child.process.wait, CHILD_END_S)
        except subprocess.TimeoutExpired:
            await self._take_over(child, f"the adapter host did not end within {CHILD_END_S:g} s")
        self._log.info("the adapter host has ended")

    async def _wait_or_wake(self, duration_s: float) -> None:
        """Wait for `duration_s`, or until an event occurs."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._woken.wait(), duration_s)
        if not self._ended:
            self._woken.clear()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until ended. Return 0, or 2 with one line on stderr for bad input."""
    parser = host_parser(
        "python -m adapters.host.guardian", "Start an adapter host, watch it, and take over when it fails."
    )
    parser.add_argument("--hung-ms", type=int, default=HUNG_MS, help="silence after which the host counts as hung")
    parser.add_argument("--feed-watchdog", action="store_true", help="feed the watchdog of the service manager")
    parser.add_argument("--parent", type=int, help="end, with the host, when this parent process ends")
    options = parser.parse_args(arguments)
    try:
        fleet, controllers = load_host(options.fleet, options.host)
        sink = open_sink(options.log)
        if options.parent is not None:
            die_with_parent(options.parent)
        set_realtime_priority(RealtimePriority.GUARDIAN, children=False)
        asyncio.run(_run_guardian(options, fleet.fleet, controllers, sink))
    except InvalidInput as error:
        sys.stderr.write(f"{error}\n")
        return BAD_INPUT
    return 0


async def _run_guardian(
    chosen: argparse.Namespace, fleet: str, controllers: dict[str, Controller], sink: LogSink
) -> None:
    log = ProcessLog("guardian", chosen.host, LiveClock(), sink)

    async def announce() -> None:
        await announce_slow_start(chosen.connect, fleet, chosen.host)

    starts = SupervisedStarts(chosen.host, log, announce)
    guardian = HostGuardian(_child_arguments(chosen), controllers, chosen.hung_ms * NS_PER_MS, log, starts)
    call_at_signals(guardian.request_end)
    # It watches its child whether the router is there or not.
    latch = chosen.state / f"guardian-{chosen.host}.estop"
    keeping = TaskOwner(lambda error, _: _report_latch_end(error, log))
    keeping.spawn(keep_latch(chosen.connect, fleet, f"guardian-{chosen.host}", latch))
    feeding = TaskOwner()
    if chosen.feed_watchdog:
        feeding.spawn(ServiceManager().feed_watchdog(lambda: guardian.checks))
    await guardian.run()
    feeding.cancel_all()
    await keeping.end_all()
    await feeding.end_all()


def _report_latch_end(error: BaseException, log: ProcessLog) -> None:
    log.info(f"the guardian does not keep the e-stop latch: {error!r}", level="error")


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
