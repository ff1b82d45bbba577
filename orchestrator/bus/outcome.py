"""The outcome of one request: the rules that both buses share for replies, error replies and silence."""

import asyncio
from collections.abc import Callable

from orchestrator.bus.base import NoReply, RequestRefused, RequestTimeout


class RequestOutcome:
    """Collects the replies to one request and settles its future once.

    With `first_only` the first valid reply settles it; without, all valid replies are collected until no server is
    left.
    """

    def __init__(
        self,
        key: str,
        timeout_s: float,
        *,
        first_only: bool,
        on_double_answer: Callable[[str], None] = lambda _: None,
    ) -> None:
        """on_double_answer: called with the key when two processes have answered a request for one answer."""
        self.key = key
        self._on_double_answer = on_double_answer
        self._answers = 0
        self.settled: asyncio.Future[dict[str, bytes]] = asyncio.get_running_loop().create_future()
        self._timeout_s = timeout_s
        self._first_only = first_only
        self._replies: dict[str, bytes] = {}
        self._refusal: str | None = None

    @property
    def is_over(self) -> bool:
        """Whether replies no longer count: the request is settled, or its sender has given up."""
        return self.settled.done()

    @property
    def has_reply(self) -> bool:
        """Whether any reply has arrived, valid or an error."""
        return bool(self._replies) or self._refusal is not None

    def add_reply(self, key: str, payload: bytes) -> None:
        """Take a valid reply. Of several on one key the first counts."""
        self._replies.setdefault(key, payload)
        self._count_answer()
        if self._first_only:
            self._settle_future()

    def add_refusal(self, text: str) -> None:
        """Take an error reply. It counts only if no valid one arrives; of several the first."""
        self._count_answer()
        if self._refusal is None:
            self._refusal = text

    def _count_answer(self) -> None:
        self._answers += 1
        if self._first_only and self._answers == 2:
            self._on_double_answer(self.key)

    def end_replies(self) -> None:
        """No server is left that could still answer."""
        self._settle_future(NoReply(f"no process serves {self.key}"))

    def end_by_timeout(self) -> None:
        """The timeout has expired."""
        self._settle_future(RequestTimeout(f"no valid reply on {self.key} within {self._timeout_s:g} s"))

    def end_by_error(self, reason: Exception) -> None:
        """The bus cannot wait any longer."""
        if not self.is_over:
            self.settled.set_exception(reason)

    def _settle_future(self, silence: Exception | None = None) -> None:
        if self.is_over:
            return
        if self._replies or not self._first_only or silence is None:
            self.settled.set_result(self._replies)
        elif self._refusal is not None:
            self.settled.set_exception(RequestRefused(self._refusal))
        else:
            self.settled.set_exception(silence)
