"""The command of `notify` as a process of its own: killed with all that it has started when it takes too long."""

import asyncio
import os
import signal
from collections.abc import Mapping, Sequence
from contextlib import suppress

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.realtime import reset_priority
from orchestrator.coordinator.leadership.environment import CommandResult

MAX_SAID = 500  # bytes of its standard error that are kept
READ_BYTES = 65_536


async def run_command_process(
    words: Sequence[str], text: bytes, variables: Mapping[str, str], timeout_ns: int
) -> CommandResult:
    """Run a command; `text` (less than 64 kB) is its standard input, and `variables` are added to its environment. What
    it prints is left out, but for the beginning of its standard error. Raises nothing."""
    output = bytearray()
    inner, input_writer = os.pipe()
    errors, error_writer = os.pipe()
    loop = asyncio.get_running_loop()

    def take_errors() -> None:
        output.extend(os.read(errors, READ_BYTES)[: MAX_SAID - len(output)])

    try:
        # The kernel keeps it until the command reads it: nothing waits for a command that never does.
        os.write(input_writer, text)
        os.close(input_writer)
        os.set_blocking(errors, False)
        loop.add_reader(errors, take_errors)
        try:
            process = await asyncio.create_subprocess_exec(
                *words,
                stdin=inner,
                stdout=asyncio.subprocess.DEVNULL,
                stderr=error_writer,
                env={**os.environ, **variables},
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            return CommandResult(None, f"{words[0]}: {getattr(error, 'strerror', None) or error}")
        reset_priority(process.pid)
        code = await _wait_for_end(process, timeout_ns)
        with suppress(BlockingIOError):
            take_errors()
    finally:
        loop.remove_reader(errors)
        for descriptor in (inner, errors, error_writer):
            os.close(descriptor)
    if code is None:
        return CommandResult(None, f"killed after {timeout_ns / NS_PER_S:g} s")
    return CommandResult(code, output.decode("utf-8", "replace").strip())


async def _wait_for_end(process: asyncio.subprocess.Process, timeout_ns: int) -> int | None:
    """The exit code; None if it took too long. Nothing of it is left running then, nor when this is cancelled."""
    try:
        async with asyncio.timeout(timeout_ns / NS_PER_S):
            return await process.wait()
    except TimeoutError:
        return None
    finally:
        if process.returncode is None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()
