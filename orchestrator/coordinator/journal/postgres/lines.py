"""The line of a server's history: its system identifier, and its timeline, which each promotion counts up.

After a split of the site's own making two servers of one system take writes. What was written on the older line since
is lost for the newer one: a journal never goes back to it, and no coordinator leads on it.
"""

from collections.abc import Sequence
from typing import NamedTuple

from psycopg.conninfo import make_conninfo

from orchestrator.coordinator.journal.postgres.address import JournalAddress
from orchestrator.coordinator.journal.postgres.reach import list_hosts
from orchestrator.coordinator.journal.records import HistoryLost

_REMEDY = "end the older server, or make it a standby of the newer one (pg_rewind), and see what was written to it"


class ServerLine(NamedTuple):
    """Where a server is in its history. name: what messages name it by. timeline: 0 for a standby."""

    name: str
    system: str
    timeline: int

    def require_not_older(self, other: "ServerLine") -> None:
        """Raises `HistoryLost` if this line is older than another one, or of another system."""
        if self.system != other.system:
            text = f"{self.name} is of another system than {other.name}: it is no copy of it"
            raise HistoryLost(text, "correct the address: all its hosts must be a primary and its standbys")
        if self.timeline < other.timeline:
            text = f"{self.name} is a primary of timeline {self.timeline}, and {other.name} one of {other.timeline}"
            raise HistoryLost(f"{text}: it is the older line", _REMEDY)


class SeenLine:
    """The newest line that the sessions of one journal have been connected to."""

    def __init__(self) -> None:
        self._newest: ServerLine | None = None

    def take_line(self, line: ServerLine) -> None:
        """A session is connected to a server. Raises `HistoryLost` if that is an older line."""
        if self._newest is not None:
            line.require_not_older(self._newest)
        self._newest = line


def split_hosts(address: JournalAddress) -> Sequence[JournalAddress]:
    """The address of each host of an address alone, whatever it takes."""
    return [
        JournalAddress(
            make_conninfo(address.conninfo, host=name, port=port, target_session_attrs="any"),
            f"postgresql://{name}:{port}",
        )
        for name, port in list_hosts(address.conninfo)
    ]
