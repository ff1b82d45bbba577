"""The requests of a process: what both buses do with a request, apart from how it is sent and its replies arrive."""

from abc import ABC, abstractmethod
from collections.abc import Callable

from orchestrator.bus.expression import check_expression, check_key
from orchestrator.bus.outcome import RequestOutcome


class RequestingBus(ABC):
    """The part of a `Bus` that sends requests."""

    def __init__(self) -> None:
        self._on_double_answer: Callable[[str], None] = lambda _: None

    async def request(self, key: str, payload: bytes, timeout_s: float, server: str | None = None) -> bytes:
        on_double_answer = self._on_double_answer
        outcome = RequestOutcome(
            check_key(key), timeout_s, first_only=True, expected=server, on_double_answer=on_double_answer
        )
        await self._collect_replies(outcome, payload, timeout_s)
        return next(iter(outcome.replies.values()))

    async def request_all(self, expression: str, payload: bytes, timeout_s: float) -> dict[str, bytes]:
        outcome = RequestOutcome(check_expression(expression), timeout_s, first_only=False)
        await self._collect_replies(outcome, payload, timeout_s)
        return outcome.replies

    async def find_servers(self, expression: str, timeout_s: float) -> dict[str, set[str]]:
        outcome = RequestOutcome(check_expression(expression), timeout_s, first_only=False)
        await self._collect_replies(outcome, b"", timeout_s)
        return outcome.require_servers()

    def report_double_answers(self, callback: Callable[[str], None]) -> None:
        self._on_double_answer = callback

    @abstractmethod
    async def _collect_replies(self, outcome: RequestOutcome, payload: bytes, timeout_s: float) -> None:
        """Send the request of `outcome`, and add its replies until it is settled. Raises `BusError`."""
