"""Processes of a fleet that are started apart, here or in network namespaces."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from children import LIMIT_S, wait_until
from fleet import find_descendants, list_processes


class Part:
    """A process of a computer, with what it says in a file. computer: a network namespace; empty: this computer."""

    def __init__(self, folder: Path, computer: str, identity: Path | None, *command: str) -> None:
        self.said = folder / f"{computer or 'here'}-{len(list(folder.iterdir()))}.out"
        environment = dict(os.environ)
        if identity is not None:
            environment["TUTTI_IDENTITY"] = str(identity)
        place = ["ip", "netns", "exec", computer] if computer else []
        with self.said.open("w") as out:
            self.process = subprocess.Popen(
                [*place, *command],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=subprocess.STDOUT,
                text=True,
                env=environment,
            )

    def wait_for(self, words: str) -> None:
        wait_until(lambda: words in self.said.read_text() or self.process.poll() is not None, words)
        assert words in self.said.read_text(), self.said.read_text()

    def order(self, word: str) -> None:
        assert self.process.stdin is not None
        before = self.said.read_text().count(word)
        self.process.stdin.write(f"{word}\n")
        self.process.stdin.flush()
        wait_until(lambda: self.said.read_text().count(word) > before, word)

    def kill(self) -> None:
        """Kill it with all its processes at once, as the death of its computer does."""
        for pid in find_descendants({self.process.pid}, list_processes()):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        assert self.process.stdin is not None
        self.process.stdin.close()

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        if self.process.stdin is not None:
            self.process.stdin.close()
        sys.stdout.write(f"--- {self.said.name}\n{self.said.read_text()[-3000:]}\n")
