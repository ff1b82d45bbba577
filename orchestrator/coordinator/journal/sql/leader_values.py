"""What the next leader takes over, as single values: epoch, scale of fleet time, stop of the queue, instances."""

import json
import re
from collections.abc import Mapping

from pydantic import ValidationError

from orchestrator.coordinator.journal.records import BRING_BACK, UNREADABLE_TIME, EpochOvertaken, JournalError
from orchestrator.coordinator.journal.sql.database import Database, JournalPart
from orchestrator.coordinator.journal.sql.values import StoredValues
from orchestrator.model.messages import MAX_EPOCH, MAX_EPOCH_STEP
from orchestrator.model.queue import QueueStop


class LeaderValues(JournalPart):
    """The single values of `JournalStore`."""

    def __init__(self, db: Database) -> None:
        super().__init__(db)
        self._values = StoredValues(db)

    def take_epoch(self, seen: int) -> int:
        with self._db.transaction(copied=True):
            last = self._read_epoch()
            epoch = max(last, seen if seen <= last + MAX_EPOCH_STEP else 0) + 1
            self._values.write("epoch", str(epoch))
        return epoch

    def require_latest_epoch(self, epoch: int) -> None:
        last = self._read_epoch()
        if last > epoch:
            raise make_overtaken_error(epoch, last)

    def _read_epoch(self) -> int:
        epoch_text = self._values.read("epoch", "0")
        if not epoch_text.isdecimal() or int(epoch_text) > MAX_EPOCH:
            raise JournalError(
                f"{self._db.name}: the journal cannot be used (its epoch {epoch_text!r} is damaged)",
                BRING_BACK,
            )
        return int(epoch_text)

    def set_epoch(self, epoch: int) -> None:
        """Put an epoch into a journal that no coordinator uses. Raises `JournalError`."""
        with self._db.transaction():
            self._values.write("epoch", str(epoch))

    def fleet_time_scale(self, kernel_id: str, now_ns: int, scale_id: str) -> tuple[str, int]:
        with self._db.transaction():
            origin = self._values.read("origin_host_ns")
            if self._values.read("kernel_id") == kernel_id and re.fullmatch(r"-?\d+", origin):
                return self._values.read("scale_id"), int(origin)
            self._values.write("kernel_id", kernel_id)
            self._values.write("scale_id", scale_id)
            self._values.write("origin_host_ns", str(now_ns))
        return scale_id, now_ns

    def load_queue_stop(self) -> QueueStop | None:
        text = self._values.read("queue_stop")
        try:
            return QueueStop.read_stored(text) if text else None
        except ValidationError:
            # Stopped is the safe reading.
            return QueueStop(reason="its state in the journal is damaged", actor="coordinator", utc=UNREADABLE_TIME)

    def store_queue_stop(self, stop: QueueStop | None) -> None:
        with self._db.transaction():
            self._values.write("queue_stop", "" if stop is None else stop.model_dump_json())

    def load_instances(self) -> dict[str, str]:
        try:
            instances: dict[str, str] = json.loads(self._values.read("instances", "{}"))
        except ValueError:
            return {}  # every adapter then counts as started again
        return instances

    def store_instances(self, instances: Mapping[str, str]) -> None:
        with self._db.transaction():
            self._values.write("instances", json.dumps(dict(instances)))


def make_overtaken_error(epoch: int, last: int) -> EpochOvertaken:
    """The error of a coordinator after whose epoch another one was taken."""
    return EpochOvertaken(f"epoch {epoch} is over: a coordinator leads with epoch {last}")
