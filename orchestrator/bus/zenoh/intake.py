"""What a process takes of the messages that Zenoh brings: within the limit of their key, before they are copied."""

# pyright: reportUnknownMemberType=false

import zenoh

from orchestrator.bus.base import Priority
from orchestrator.bus.budgets import MessageKind, describe_large_request, find_most_bytes, is_estop_key
from orchestrator.bus.limits import LossCounter


class PayloadIntake:
    """Takes payloads. process_bytes: the most of any message; many keys have less. losses: counts what is left out."""

    def __init__(self, process_bytes: int, losses: LossCounter) -> None:
        self._process_bytes, self._losses = process_bytes, losses

    def take_payload(self, payload: zenoh.ZBytes, key: str, kind: MessageKind) -> bytes | None:
        """The bytes of a payload; None if they are more than is taken on the key, which is counted."""
        size, max_bytes = len(payload), find_most_bytes(kind, key, self._process_bytes)
        if size <= max_bytes:
            return payload.to_bytes()
        self._losses.count_loss(f"{size} bytes on {key} are left out; at most {max_bytes} are taken")
        return None

    def take_sample(self, payload: zenoh.ZBytes, key: str, priority: Priority) -> bytes | None:
        """The bytes of a sample. One that cannot be read is an e-stop, too, if it was published as one."""
        taken_payload = self.take_payload(payload, key, "sample")
        if taken_payload is None and (priority is Priority.ESTOP or is_estop_key(key)):
            return b""
        return taken_payload

    def describe_large_query(self, query: zenoh.Query, key: str) -> str:
        """The refusal of a request that is too large."""
        size = 0 if query.payload is None else len(query.payload)
        return describe_large_request(key, size, self._process_bytes)
