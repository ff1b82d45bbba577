"""Python processes from a fork server; each test process has one, which is started when it is first needed."""

import atexit
import json
import os
import select
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from pathlib import Path
from signal import SIGKILL, SIGTERM, Signals
from typing import IO


class ForkedProcess:
    """`python` with `arguments` from the fork server, with pipes; used like `subprocess.Popen`."""

    def __init__(
        self, arguments: list[str], environment: Mapping[str, str], output: tuple[IO[str], IO[str]] | None = None
    ) -> None:
        self.args = arguments
        self.returncode: int | None = None
        theirs: list[int] = []
        self.stdin: IO[str] | None = None
        self.stdout: IO[str] | None = None
        self.stderr: IO[str] | None = None
        if output is None:
            (take, give), (out_reader, out), (error_reader, error) = os.pipe(), os.pipe(), os.pipe()
            self.stdin, self.stdout, self.stderr = os.fdopen(give, "w"), os.fdopen(out_reader), os.fdopen(error_reader)
            theirs = [take, out, error]
        else:
            theirs = [os.open(os.devnull, os.O_RDONLY), *(os.dup(each.fileno()) for each in output)]
        self._end, end = socket.socketpair()
        request = {"arguments": arguments, "environment": dict(environment), "folder": str(Path.cwd())}
        socket.send_fds(_server().control, [json.dumps(request).encode()], [end.fileno(), *theirs])
        end.close()
        for each in theirs:
            os.close(each)
        self.pid = int(self._end.recv(20))

    def poll(self) -> int | None:
        with suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None:
            if not select.select([self._end], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(self.args, timeout or 0)
            self.returncode = int(self._end.recv(20) or -SIGKILL)
            self._end.close()
        return self.returncode

    def send_signal(self, number: Signals) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it ended just now
                os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(SIGTERM)

    def kill(self) -> None:
        self.send_signal(SIGKILL)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Close its input, and read what it prints to its end."""
        assert self.stdin is not None and self.stdout is not None and self.stderr is not None
        self.stdin.close()
        with ThreadPoolExecutor(2) as readers:
            reading = [readers.submit(each.read) for each in (self.stdout, self.stderr)]
            try:
                self.wait(timeout)
            except subprocess.TimeoutExpired:
                self.kill()  # which ends the readers
                raise
            out, error = (each.result() for each in reading)
        self.stdout.close()
        self.stderr.close()
        return out, error


class _Server:
    def __init__(self) -> None:
        self.control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, str(Path(__file__).with_name("fork_server.py")), str(theirs.fileno())]
        # Threads of a library would be lost by a fork.
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, env=environment, start_new_session=True
        )
        theirs.close()
        atexit.register(self.close)

    def close(self) -> None:
        self.control.close()
        self.process.wait()


@cache
def _server() -> _Server:
    return _Server()


def server_pid() -> int:
    """The parent of forked processes."""
    return _server().process.pid


def run_forked(
    arguments: list[str], environment: Mapping[str, str], timeout_s: float
) -> "subprocess.CompletedProcess[str]":
    """`python` with `arguments` to its end, with empty input."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as error:
        process = ForkedProcess(arguments, environment, (out, error))
        try:
            code = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise
        out.seek(0)
        error.seek(0)
        return subprocess.CompletedProcess(arguments, code, out.read(), error.read())
