"""Commands against a fleet in virtual time: the whole demo fleet, and the `tutti` command as a user calls it."""

import asyncio
import contextlib
import json
from collections.abc import Coroutine, Iterator
from typing import Any, TypeVar

import pytest
from click.testing import CliRunner, Result
from cluster.worlds import demo_fleet

import orchestrator.client
from orchestrator.cli.base import common, errors
from orchestrator.cli.jobs import foreground
from orchestrator.cli.main import main
from orchestrator.client.api import Tutti
from orchestrator.clock.virtual import VirtualClock, VirtualLoop
from orchestrator.runtime.virtual.fleet import VirtualFleet

T = TypeVar("T")


class CommandWorld:
    """The demo fleet in virtual time. It stands still between commands."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.loop = VirtualLoop()
        self.fleet = VirtualFleet(demo_fleet(), VirtualClock(self.loop), 1)
        self.wait(self.fleet.start())
        world = self

        class ConnectedTutti(Tutti):
            """Connects to the virtual bus, whatever the endpoint."""

            def __init__(self, _: object, fleet: str | None = None, actor: str = "api") -> None:
                super().__init__(world.fleet.make_client("command").bus, fleet, actor, world.fleet.draw_id)

        monkeypatch.setattr(orchestrator.client, "Tutti", ConnectedTutti)
        monkeypatch.setattr(common, "run_main", self._run_main)
        monkeypatch.setattr(foreground, "count_interrupts", lambda: contextlib.nullcontext(foreground.Interrupts()))
        monkeypatch.setenv("TUTTI_DEBUG", "1")
        monkeypatch.setenv("TUTTI_ACTOR", "anna")

    def _run_main(self, coroutine: Coroutine[Any, Any, T]) -> T:
        async def run_command() -> T | SystemExit:
            try:
                return await coroutine
            except SystemExit as ended:
                # Through the loop it would leave it in the middle of its work.
                return ended

        with errors.expected_errors():
            result = self.wait(run_command())
        if isinstance(result, SystemExit):
            raise result
        return result

    def wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        return self.loop.run_until_complete(coroutine)

    def let_pass(self, duration_s: float) -> None:
        self.wait(asyncio.sleep(duration_s))

    def run(self, *words: str) -> Result:
        """The command with its arguments."""
        return CliRunner().invoke(main, list(words), prog_name="tutti")

    def done(self, *words: str) -> str:
        """What a command prints that must succeed."""
        result = self.run(*words)
        assert result.exit_code == 0, (words, result.output)
        return result.stdout.rstrip()

    def refused(self, code: int, *words: str) -> str:
        """What a command says that must fail with this exit code; with `--json` it is one object, and nothing else."""
        result = self.run(*words)
        assert result.exit_code == code, (words, result.exit_code, result.output)
        assert not result.stdout
        again = self.run(*words, "--json")
        assert again.exit_code == code, (words, again.output)
        value = json.loads(again.stdout)
        assert set(value) >= {"code", "text", "remedy"}
        assert not again.stderr
        # Ids differ between two calls; otherwise both forms are the same text.
        assert value["text"].split()[0] in result.stderr
        return result.stderr


def open_world(monkeypatch: pytest.MonkeyPatch) -> Iterator[CommandWorld]:
    """For a fixture."""
    world = CommandWorld(monkeypatch)
    try:
        yield world
    finally:
        world.loop.close()
