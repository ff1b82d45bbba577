"""An operator of the campaign that knows nothing of the machine: it runs exactly the commands that the fleet names.

Invariant 13: after the last fault the fleet does a job by itself, or names the command that a person has to run.
"""

import re
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress

from orchestrator.client.api import Tutti
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.restart import RESTART
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import QueueEntry

_COMMAND = re.compile(r"`tutti ([^`]+)`")
_REMEDY_SPEED = 0.05  # of the limits, of a move that is named
MOST_REPEATS = 12
"""The same command is named again while it is refused, or while it was run too early: a daisy chain takes ten seconds
until it is reached; not for ever."""


class NamedCommands:
    """Runs the commands named in the reasons of waiting jobs, and in those of failed ones if the fleet has a beam.
    run_step: runs a job of one step, as the command does, and returns when it has ended; it ends with its command."""

    def __init__(self, client: Tutti, run_step: Callable[[Job, QueueTerms], Awaitable[None]], fleet: Fleet) -> None:
        self._client = client
        self._run_step = run_step
        self._squares = bool(fleet.virtual_axes.pairs)
        self.commands: list[str] = []
        self._remedied = set[str]()

    @property
    def is_repeating(self) -> bool:
        """Whether one command was named so often that it evidently has no effect."""
        return any(self.commands.count(command) > MOST_REPEATS for command in self.commands)

    async def run_named(self, waiting: Sequence[QueueEntry]) -> str:
        """Run the first command that the jobs name, after all that jobs name which wait at a step; return the last
        one, empty if none is named. Raises `Refusal`."""
        words = await self._run_resumption() or await self._run_remedy()
        if words:
            return words
        for entry in waiting:
            match = _COMMAND.search(entry.reason)
            is_held = entry.held_by not in ("", RESTART)
            words = f"job release {entry.id}" if is_held else match[1] if match else ""
            if words:
                self.commands.append(words)
                with suppress(Refusal):  # the next look shows what is still named
                    await self._run(words.split())
                return words
        return ""

    async def _run_remedy(self) -> str:
        """Run the move that the newest failed job names, which squares a beam, once for each job; return the command,
        empty if none is named. Raises `Refusal`."""
        jobs = (await self._client.list_jobs(limit=1, state="failed")).jobs if self._squares else []
        if not jobs or jobs[0].id in self._remedied:
            return ""
        self._remedied.add(jobs[0].id)
        words = next((words for words in _COMMAND.findall(jobs[0].reason) if words.startswith("axis move ")), "")
        if words:
            self.commands.append(words)
            await self._run(words.split())
        return words

    async def _run_resumption(self) -> str:
        """Run all commands that jobs name which wait at a step; return the last, empty if none is named. Raises
        `Refusal`."""
        words = ""
        paused_jobs = (await self._client.list_jobs(state="paused")).jobs
        for words in (command for entry in paused_jobs for command in _COMMAND.findall(entry.reason)):
            self.commands.append(words)
            with suppress(Refusal):
                await self._run(words.split())
        return words

    async def _run(self, words: list[str]) -> None:
        client = self._client
        match words:
            case ["reset"]:
                await client.reset()
            case ["queue", "start"]:
                await client.start_queue()
            case ["job", "resume", job_id]:
                await client.resume_job(job_id)
            case ["job", "release", *jobs]:
                await client.release_jobs(*jobs)
            case ["axis", "enable" | "home" as verb, *axes] if axes:
                step = {"do": verb, "axes": axes}
                plain = {"schema": "tutti.job/1", "name": f"manual: {verb}", "steps": [step]}
                await self._run_step(Job.model_validate(plain), QueueTerms(now=True))
            case ["axis", "move", target]:
                axis, _, position = target.partition("=")
                step = {"do": "move", "to": {axis: float(position)}, "speed": _REMEDY_SPEED}
                plain = {"schema": "tutti.job/1", "name": "manual: move", "steps": [step]}
                await self._run_step(Job.model_validate(plain), QueueTerms())
            case ["repair", "epoch"]:
                await client.repair_epoch()
            case _:
                pass  # it repairs nothing, and will be named again
