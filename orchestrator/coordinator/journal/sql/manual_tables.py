"""What people keep in the journal besides jobs: reservations of axes for work at the machine, and named positions."""

from collections.abc import Iterable
from zlib import crc32

from orchestrator.coordinator.journal.facts import Reservation
from orchestrator.coordinator.journal.sql.database import JournalPart, make_upsert
from orchestrator.coordinator.journal.sql.saved_positions import read_positions
from orchestrator.model.positions.entries import SavedPosition

_STORE_RESERVATION = make_upsert("reservations", ["holder"], ["actor", "what", "axes", "until_utc"])
_STORE_POSITION = make_upsert("positions", ["name"], ["body", "crc"])


class ManualTables(JournalPart):
    """The methods of `JournalStore` about reservations and positions."""

    def store_reservation(self, holder: str, actor: str, what: str, axes: Iterable[str], until_utc: str) -> None:
        with self._db.transaction():
            self._db.write(_STORE_RESERVATION, (holder, actor, what, " ".join(axes), until_utc))

    def delete_reservation(self, holder: str) -> None:
        with self._db.transaction():
            self._db.write("DELETE FROM reservations WHERE holder = ?", (holder,))

    def list_reservations(self) -> list[Reservation]:
        rows = self._db.select("SELECT holder, actor, what, axes, until_utc FROM reservations ORDER BY rowid")
        return [Reservation(holder, actor, use, tuple(axes.split()), utc) for holder, actor, use, axes, utc in rows]

    def store_position(self, position: SavedPosition) -> None:
        with self._db.transaction():
            body = position.model_dump_json()
            self._db.write(_STORE_POSITION, (position.name, body, crc32(body.encode())))

    def delete_position(self, name: str) -> None:
        with self._db.transaction():
            self._db.write("DELETE FROM positions WHERE name = ?", (name,))

    def list_positions(self) -> tuple[list[SavedPosition], list[str]]:
        return read_positions(self._db.select("SELECT name, body, crc FROM positions ORDER BY name"))
