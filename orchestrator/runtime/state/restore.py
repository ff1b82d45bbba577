"""Brings a backup or an export back into a state folder that no fleet runs with.

Everything is unpacked and checked in a folder beside its place first, and the journal is moved last: an import that
fails has changed nothing. What the folder has besides the journal stays as it is, because it is newer than the file: an
e-stop that is latched stays latched, and offsets of axes belong to where these are. The queue is stopped: jobs that
were waiting when the file was written may have run since.
"""

import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, NamedTuple

from adapters.controller.state.store import FileStore
from orchestrator.coordinator.journal.records import BadBackup, JournalError
from orchestrator.coordinator.journal.sql.inspection import JournalDamage
from orchestrator.coordinator.journal.sqlite.inspection import check_journal
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.portable import import_journal, read_stored_epoch
from orchestrator.model.files.private_files import make_private_folder, sync_folder
from orchestrator.model.messages import MAX_EPOCH
from orchestrator.model.queue import QueueStop
from orchestrator.runtime.state.backup import unpack_backup
from orchestrator.runtime.state.folder import ADAPTERS, JOURNAL, StateLock

REPLACED = "replaced-"  # with the time, the folder of a journal that an import has replaced
REMEDY_REPLACE = (
    "give another folder with --state, or --replace: the present journal is then kept in it beside the new one"
)


class ImportedState(NamedTuple):
    """What an import has done. replaced: the folder of the journal of before. left_out: files of the backup that the
    folder had already. damages: records that cannot be read, in the file as in the journal. checked: a change of the
    file would have been seen."""

    epoch: int
    jobs: dict[str, int]
    replaced: Path | None
    left_out: list[str]
    damages: list[JournalDamage]
    checked: bool = True


class ImportWishes(NamedTuple):
    """replace: a journal in the folder is kept beside the new one. require_checksum: refuse an export in which a change
    cannot be seen. actor, utc: of the import. seen: epochs of controllers on the bus."""

    actor: str
    utc: str
    replace: bool = False
    require_checksum: bool = False
    seen: tuple[int, ...] = ()


def import_state(file: Path, folder: Path, wishes: ImportWishes) -> ImportedState:
    """Import a backup or an export. Raises `JournalError`, `UpFailed`, `OSError`; then nothing has changed."""
    try:
        with file.open("rb") as source:
            return _import_opened(source, file, folder, wishes)
    except IsADirectoryError:
        raise BadBackup(f"{file}: it is a folder", "give a file of `tutti journal backup` or `export`") from None


def _import_opened(source: BinaryIO, file: Path, folder: Path, wishes: ImportWishes) -> ImportedState:
    lock = StateLock(folder)
    try:
        if (folder / JOURNAL).exists() and not wishes.replace:
            raise JournalError(f"{folder}: it has a journal already", REMEDY_REPLACE)
        with TemporaryDirectory(prefix=".import-", dir=folder) as scratch:
            fresh = Path(scratch)
            has_checksum = _unpack(source, str(file), fresh, wishes)
            epoch = _find_epoch(fresh, folder, wishes.seen)
            damages = _prepare_journal(fresh / JOURNAL, file, epoch, wishes)
            jobs = check_journal(fresh / JOURNAL).jobs
            old_folder = _set_aside(folder, wishes.utc)
            left_out = _move_files(fresh, folder)
        sync_folder(folder)
        return ImportedState(epoch, jobs, old_folder, left_out, damages, has_checksum)
    finally:
        lock.release()


def _unpack(source: BinaryIO, name: str, fresh: Path, wishes: ImportWishes) -> bool:
    """Unpack a file of either kind; return whether a change of it would have been seen."""
    is_text = source.read(1) == b"{"
    source.seek(0)
    if is_text:
        return import_journal(source, name, fresh / JOURNAL, require_checksum=wishes.require_checksum)
    unpack_backup(source, name, fresh)
    return True


def _find_epoch(fresh: Path, folder: Path, seen: Iterable[int]) -> int:
    """An epoch above every one that is known; one that no coordinator can take is no real one."""
    epochs = [read_stored_epoch(fresh / JOURNAL), *seen]
    if (folder / JOURNAL).exists():
        with suppress(JournalError):  # one that cannot be read is what is replaced
            epochs.append(read_stored_epoch(folder / JOURNAL))
    for state_folder in (folder, fresh):
        epochs += [FileStore(path).load().epoch for path in (state_folder / ADAPTERS).glob("*.json")]
    return max(epoch for epoch in (0, *epochs) if epoch < MAX_EPOCH) + 1


def _prepare_journal(path: Path, file: Path, epoch: int, wishes: ImportWishes) -> list[JournalDamage]:
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


def _set_aside(folder: Path, utc: str) -> Path | None:
    """Move the present journal into a folder beside it, which `tutti journal check --state` reads too."""
    present = sorted(folder.glob(f"{JOURNAL}*"))
    if not present:
        return None
    kept_folder = folder / (REPLACED + re.sub(r"[^0-9TZ]", "", utc.replace(".", "T", 1)))
    make_private_folder(kept_folder)
    for path in present:
        path.rename(kept_folder / path.name)
    sync_folder(kept_folder)
    sync_folder(folder)
    return kept_folder


def _move_files(fresh: Path, folder: Path) -> list[str]:
    """Move what was unpacked to its place, the journal last; return the files that stay as they were."""
    left_out: list[str] = []
    names = sorted(str(path.relative_to(fresh)) for path in fresh.rglob("*") if path.is_file())
    for name in sorted(names, key=lambda file_name: file_name == JOURNAL):
        target = folder / name
        if target.exists():
            left_out.append(name)
            continue
        make_private_folder(target.parent)
        (fresh / name).rename(target)
    with suppress(FileNotFoundError):
        sync_folder(folder / ADAPTERS)
    return left_out
