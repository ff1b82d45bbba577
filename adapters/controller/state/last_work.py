"""The job that has commanded something last which may have changed the machine: what a journal that has lost its last
records does not know."""

from orchestrator.model.messages import FencedRequest, LeasedRequest, StepRequest

WORKS = ("commit", "go", "start-at-once", "enable", "home", "set-position", "probe")
"""Verbs of a job that may change something at the machine."""


class LastWork:
    """Since the adapter has started. job: its id, or another holder of the axes; empty: none. step: its number, where
    the command was of one."""

    def __init__(self) -> None:
        self.job = ""
        self.step: int | None = None

    def note_request(self, verb: str, request: FencedRequest) -> None:
        """Take note of a request that is about to be executed."""
        if verb in WORKS and isinstance(request, StepRequest):
            self.job, self.step = request.job, request.step
        elif verb in WORKS and isinstance(request, LeasedRequest):
            self.job, self.step = request.holder, None
