"""The outcome of one request: the rules that both buses share for replies, error replies and silence."""

import asyncio
from collections.abc import Callable

from orchestrator.bus.base import BusError, NoReply, OtherServer, RequestRefused, RequestTimeout


class RequestOutcome:
    """Collects the replies to one request and settles its future once.

    With `first_only` the first valid reply settles it, or, where a server is expected, the first reply of that one;
    without, all valid replies are collected until no server is left.
    """

    def __init__(
        self,
        key: str,
        timeout_s: float,
        *,
        first_only: bool,
        expected: str | None = None,
        on_double_answer: Callable[[str], None] = lambda _: None,
    ) -> None:
        """expected: the server whose reply counts, and no other; None: any. on_double_answer: called with the key when
        two processes have answered a request for one answer."""
        self.key = key
        self.replies: dict[str, bytes] = {}
        """The valid replies by key; of several on one key the first."""
        self.servers: dict[str, set[str]] = {}
        """By key the processes that have sent a valid reply."""
        self.silence: BusError | None = None
        """Why no reply has arrived, once the request is settled without one."""
        self._expected = expected
        self._on_double_answer = on_double_answer
        self._answers = 0
        self.settled: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._timeout_s = timeout_s
        self._first_only = first_only
        self._refusal: str | None = None

    @property
    def is_over(self) -> bool:
        """Whether replies no longer count: the request is settled, or its sender has given up."""
        return self.settled.done()

    @property
    def has_reply(self) -> bool:
        """Whether any reply has arrived, valid or an error, of any server."""
        return self._answers > 0

    def add_reply(self, server: str, key: str, payload: bytes) -> None:
        """Take a valid reply of `server`. Of several on one key the first counts."""
        if self._counts_answer(server):
            self.replies.setdefault(key, payload)
            self.servers.setdefault(key, set()).add(server)
            if self._first_only:
                self._settle_future()

    def add_refusal(self, server: str, text: str) -> None:
        """Take an error reply of `server`. Of several the first counts, and only if no valid reply arrives."""
        if self._counts_answer(server):
            if self._refusal is None:
                self._refusal = text
            if self._expected is not None:
                self._settle_future()

    def _counts_answer(self, server: str) -> bool:
        self._answers += 1
        if self._first_only and self._answers == 2:
            self._on_double_answer(self.key)
        return self._expected in (None, server)

    def end_replies(self) -> None:
        """No server is left that could still answer."""
        if self._expected is not None and self.has_reply:
            self._settle_future(OtherServer(f"{self.key} is answered by another process than the expected one"))
        else:
            self._settle_future(NoReply(f"no process serves {self.key}"))

    def end_by_timeout(self) -> None:
        """The timeout has expired."""
        self._settle_future(RequestTimeout(f"no valid reply on {self.key} within {self._timeout_s:g} s"))

    def end_by_error(self, reason: Exception) -> None:
        """The bus cannot wait any longer."""
        if not self.is_over:
            self.settled.set_exception(reason)

    def require_servers(self) -> dict[str, set[str]]:
        """By key the processes that have sent a valid reply. Raises `NoReply`, `RequestTimeout` if there is none."""
        if not self.servers:
            raise self.silence or NoReply(f"no process serves {self.key}")
        return self.servers

    def _settle_future(self, silence: BusError | None = None) -> None:
        if self.is_over:
            return
        self.silence = silence
        if self.replies or not self._first_only:
            self.settled.set_result(None)
        elif self._refusal is not None:
            self.settled.set_exception(RequestRefused(self._refusal))
        else:
            self.settled.set_exception(silence or NoReply(f"no process serves {self.key}"))
