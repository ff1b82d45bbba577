"""A recorder of the beginnings of jobs that had to wait for a cause: each needs a word of a person since then."""

import json

from orchestrator.bus.base import BusSample, RequestHandler
from orchestrator.clock.base import Clock
from orchestrator.model.report import FINISHED_STATES

WORDS = ("start-queue", "release")
NO_CAUSES = ("is not adopted by this coordinator", "its adapter does not answer")
"""What a job waits for after the change of a leader, for a moment, and begins without a word."""


class StartRecorder:
    """Records what coordinators publish about waiting jobs, and the words of persons for their start."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._waited: dict[str, tuple[int, str]] = {}
        """By job, when it was last published that it waits for a cause, and for which."""
        self._word_ns = -1
        self._unasked: list[str] = []

    def note_publication(self, key: str, payload: bytes) -> None:
        """A coordinator publishes."""
        *_, kind, job_id, last = ["", "", *key.split("/")]
        if (kind, last) != ("job", "state"):
            return
        progress = json.loads(payload)
        state, reason = progress["state"], progress["reason"]
        if state == "queued":
            if reason.startswith("waits for: ") and not any(text in reason for text in NO_CAUSES):
                self._waited[job_id] = self._clock.now_ns(), reason
        elif job_id in self._waited:
            waited_ns, cause = self._waited.pop(job_id)
            if state not in FINISHED_STATES and self._word_ns <= waited_ns:
                self._unasked.append(f"job {progress['name']} has begun by itself: it {cause}")

    def watch_handler(self, expression: str, handler: RequestHandler) -> RequestHandler:
        """The handler of a coordinator's service, which notes the words that it accepts."""
        if "/svc/" not in expression:
            return handler

        async def answer(sample: BusSample) -> bytes:
            reply = await handler(sample)
            if sample.key.rpartition("/")[2] in WORDS and json.loads(reply)["refused"] is None:
                self._word_ns = self._clock.now_ns()
            return reply

        return answer

    def take_unasked(self) -> list[str]:
        """The jobs that have begun without a word since the last call, in words."""
        texts, self._unasked = self._unasked, []
        return texts
