"""The word for a job that had to wait for a cause which is gone: it begins when what moves first was shown."""

from collections.abc import Awaitable, Callable

from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.restart import StartPreview

ReadyCallback = Callable[[StartPreview], bool | Awaitable[bool]]
"""Called with what would move first; it returns whether that may begin."""


async def ask_callback(on_ready: ReadyCallback | None, preview: StartPreview) -> bool:
    """The answer of a callback, which may be a coroutine; no, if there is none."""
    answer = on_ready is not None and on_ready(preview)
    return answer if isinstance(answer, bool) else await answer


class ReadyToBegin(Refusal):
    """A job is ready to begin, and nothing has given the word for it. preview: what would move first."""

    def __init__(self, preview: StartPreview) -> None:
        motions = "; ".join(f"{motion.name!r}: {motion.text}" for motion in preview.motions)
        text = f"what the job had to wait for is gone; first it would move {motions}"
        super().__init__("ready-to-begin", text, "look at it, then give the word: `tutti queue start`")
        self.preview = preview
