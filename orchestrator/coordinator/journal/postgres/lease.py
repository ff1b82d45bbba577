"""The lease of the leader: a row that it renews, over a connection of its own, and that no write holds.

A take-over changes another row, which every write holds: were it the same, one slow write would delay the renewal, and
a healthy leader would stop itself. Instants are not compared: a reader counts, by its own clock, from when it saw the
number of renewals change.
"""

from collections.abc import Callable
from typing import NamedTuple

from orchestrator.coordinator.journal.postgres.errors import AnswerLate
from orchestrator.coordinator.journal.postgres.health import read_health
from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, open_session
from orchestrator.coordinator.journal.postgres.names import STANDBY, name_session
from orchestrator.coordinator.journal.postgres.session import Statement

_NAME = "SELECT set_config('application_name', ?, false)"
_RENEW = (
    "UPDATE lease SET renewals = renewals + 1, renewed = clock_timestamp()"
    " FROM leader WHERE leader.epoch = ? RETURNING renewals"
)
_RELEASE = "UPDATE lease SET renewals = 0 FROM leader WHERE leader.epoch = ?"
_LOG_PLACE = Statement("SELECT pg_current_wal_flush_lsn()::text")
_READ = Statement("SELECT epoch, coordinator, renewals, renewed::text FROM leader CROSS JOIN lease")


class LeaseState(NamedTuple):
    """The leader's row, and its lease. renewals: counts up; 0: none is held. renewed: by the server's clock, for
    people."""

    epoch: int
    coordinator: str
    renewals: int
    renewed: str


class LeaseRenewal:
    """Renews the lease. For one thread at a time, which is not the journal's.

    place: its `deadline_s` is that of each call. is_copy_missing: returns whether a copy is missing; then the renewal
    is committed on the server's machine alone, else on all that the fleet asks for: a server that was replaced by its
    standby renews nothing."""

    def __init__(self, place: FleetDatabase, is_copy_missing: Callable[[], bool] = lambda: False) -> None:
        self._fleet = place.fleet
        self._copies = place.copies
        self._session = open_session(place, STANDBY)
        self._is_copy_missing = is_copy_missing
        self._awaited: str | None = None
        """The place in the log that a standby must have: a renewal before it has waited in vain. None: none has."""
        self._is_late = False

    def renew(self, epoch: int) -> bool:
        """Renew it; False: that epoch is over. Raises `JournalError`, also where no answer came in time: count from
        before the call, and only what returned True."""
        name, session = name_session(self._fleet, str(epoch)), self._session
        # Not by another connection: that may take as long as a leader without a renewal may go on.
        name_statements = [] if session.application == name else [Statement(_NAME, (name,))]
        session.application = name
        is_local = self._is_copy_missing() or self._has_waited_in_vain()
        local = [Statement("SET LOCAL synchronous_commit TO local")] if is_local else []
        statements = [*name_statements, Statement("BEGIN"), *local, Statement(_RENEW, (epoch,)), Statement("COMMIT")]
        try:
            is_renewed = bool(session.run_again(statements)[-2])
        except AnswerLate:
            self._is_late = True
            raise
        if not is_local:
            self._awaited = None
        return is_renewed

    def _has_waited_in_vain(self) -> bool:
        """Whether a renewal has waited for a copy that is missing. The journal may have written nothing meanwhile, and
        does not know. Raises `JournalError`."""
        if self._copies > 1 and self._is_late:
            (((self._awaited,),),) = self._session.run_again([_LOG_PLACE])
            self._is_late = False
        if self._awaited is None:
            return False
        return read_health(self._session, self._copies, self._awaited).mode == "waits for a copy"

    def release(self, epoch: int) -> None:
        """Give it back, unless that epoch is over. Raises `JournalError`."""
        self._session.run_again([Statement("BEGIN"), Statement(_RELEASE, (epoch,)), Statement("COMMIT")])

    def read_turn(self) -> tuple[int, int] | None:
        """The epoch of the leader, and how often it has renewed the lease; None: none is held. Raises
        `JournalError`."""
        state = self.read_state()
        return (state.epoch, state.renewals) if state.renewals else None

    def read_state(self) -> LeaseState:
        """The leader, and how often it has renewed its lease. Raises `JournalError`."""
        ((row,),) = self._session.run_again([_READ])
        return LeaseState(*row)

    def close(self) -> None:
        self._session.close()
