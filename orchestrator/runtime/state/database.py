"""The backup of a journal in PostgreSQL, and the import into one: by way of files as a fleet with SQLite has them.

So a file of either kind is read by one reader, checked as a whole, and migrated, before the database is touched; and a
backup of either comes back into the other.
"""

from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory

from orchestrator.coordinator.journal.postgres.journal import FleetDatabase
from orchestrator.coordinator.journal.postgres.tools import Filling, fill_database, open_database, read_epoch
from orchestrator.coordinator.journal.records import BadBackup
from orchestrator.coordinator.journal.sql.tables import POINTS, RECORDS
from orchestrator.coordinator.journal.sql.transfer import copy_tables
from orchestrator.coordinator.journal.sqlite.database import open_read_only
from orchestrator.coordinator.journal.sqlite.inspection import check_journal
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.points import find_points
from orchestrator.runtime.state.backup import BackupSource
from orchestrator.runtime.state.folder import JOURNAL, StateLock
from orchestrator.runtime.state.restore import ImportedState, move_files
from orchestrator.runtime.state.unpacking import ImportWishes, find_epoch, prepare_journal, unpack_file


def find_database_source(place: FleetDatabase, folder: Path | None) -> BackupSource:
    """A journal in a database, with the state folder of a computer of its fleet, if there is one."""

    def copy_journal(copies: Path) -> None:
        with open_database(place) as source, closing(SqliteJournal(copies / JOURNAL)) as target:
            for db, tables in ((target.database, RECORDS), (target.point_database, POINTS)):
                with db.transaction():
                    copy_tables(source, db, tables)
                db.end_log()

    return BackupSource(folder, copy_journal)


def import_into_database(file: Path, place: FleetDatabase, folder: Path | None, wishes: ImportWishes) -> ImportedState:
    """Import a backup or an export into a database, and what else a backup has into a state folder. Raises
    `JournalError`, `UpFailed`, `OSError`; then nothing has changed."""
    with ExitStack() as stack:
        if folder is not None:
            stack.callback(StateLock(folder).release)
        fresh = Path(stack.enter_context(TemporaryDirectory(prefix="tutti-import-", dir=folder)))
        try:
            source = stack.enter_context(file.open("rb"))
        except IsADirectoryError:
            raise BadBackup(f"{file}: it is a folder", "give a file of `tutti journal backup` or `export`") from None
        has_checksum = unpack_file(source, str(file), fresh, wishes)
        folders = [] if folder is None else [folder]
        epoch = find_epoch(fresh, folders, (*wishes.seen, read_epoch(place)))
        damages = prepare_journal(fresh / JOURNAL, file, epoch, wishes)
        jobs = check_journal(fresh / JOURNAL).jobs
        kept_schema = _fill(place, fresh / JOURNAL, epoch, wishes)
        for path in fresh.glob(f"{JOURNAL}*"):
            path.unlink()  # it is in the database
        left_out = [] if folder is None else move_files(fresh, folder)
        return ImportedState(epoch, jobs, kept_schema or None, left_out, damages, has_checksum)


def _fill(place: FleetDatabase, journal: Path, epoch: int, wishes: ImportWishes) -> str:
    # Opened once more: points are made if the file has none.
    SqliteJournal(journal).close()
    with open_read_only(journal) as records, open_read_only(find_points(journal)) as points:
        return fill_database(place, Filling(records, points, epoch, wishes.utc, wishes.replace))
