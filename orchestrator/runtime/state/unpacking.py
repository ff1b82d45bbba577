"""A file to import, in a folder: checked, migrated, with an epoch above all others, and its queue stopped."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple

from adapters.controller.state.store import FileStore
from orchestrator.coordinator.journal.records import BadBackup, JournalError
from orchestrator.coordinator.journal.sql.inspection import JournalDamage
from orchestrator.coordinator.journal.sqlite.inspection import check_journal
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.portable import import_journal, read_stored_epoch
from orchestrator.model.messages import MAX_EPOCH
from orchestrator.model.queue import QueueStop
from orchestrator.runtime.state.backup import unpack_backup
from orchestrator.runtime.state.folder import ADAPTERS, JOURNAL


class ImportWishes(NamedTuple):
    """replace: a journal in the folder is kept beside the new one. require_checksum: refuse an export in which a change
    cannot be seen. actor, utc: of the import. seen: epochs of controllers on the bus."""

    actor: str
    utc: str
    replace: bool = False
    require_checksum: bool = False
    seen: tuple[int, ...] = ()


def unpack_file(source: BinaryIO, name: str, fresh: Path, wishes: ImportWishes) -> bool:
    """Unpack a file of either kind; return whether a change of it would have been seen."""
    is_text = source.read(1) == b"{"
    source.seek(0)
    if is_text:
        return import_journal(source, name, fresh / JOURNAL, require_checksum=wishes.require_checksum)
    unpack_backup(source, name, fresh)
    return True


def find_epoch(fresh: Path, folders: Sequence[Path], seen: Iterable[int]) -> int:
    """An epoch above every one that is known, of the journal and the adapters of each folder; one that no coordinator
    can take is no real one."""
    epochs = [read_stored_epoch(fresh / JOURNAL), *seen]
    for journal in [folder / JOURNAL for folder in folders if (folder / JOURNAL).exists()]:
        with suppress(JournalError):  # one that cannot be read is what is replaced
            epochs.append(read_stored_epoch(journal))
    for state_folder in (fresh, *folders):
        epochs += [FileStore(path).load().epoch for path in (state_folder / ADAPTERS).glob("*.json")]
    return max(epoch for epoch in (0, *epochs) if epoch < MAX_EPOCH) + 1


def prepare_journal(path: Path, file: Path, epoch: int, wishes: ImportWishes) -> list[JournalDamage]:
    """Migrate the journal, and put the epoch and the stop of the queue into it; return what is damaged in it."""
    try:
        damages = check_journal(path).damages
        journal = SqliteJournal(path)
    except JournalError as error:
        text = error.text.replace(str(path), f"{file}: {JOURNAL}")
        raise BadBackup(text, "use another backup, or a newer Tutti if its schema is newer") from None
    try:
        journal.set_epoch(epoch)
        reason = f"the journal was imported from {file.name}; look which jobs still have to run"
        journal.store_queue_stop(QueueStop(reason=reason, actor=wishes.actor, utc=wishes.utc))
    finally:
        journal.close()
    return damages
