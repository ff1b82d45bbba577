"""Brings a backup or an export back into a state folder that no fleet runs with.

Everything is unpacked and checked in a folder beside its place first, and the journal is moved last: an import that
fails has changed nothing. What the folder has besides the journal stays as it is, because it is newer than the file: an
e-stop that is latched stays latched, and offsets of axes belong to where these are. The queue is stopped: jobs that
were waiting when the file was written may have run since.
"""

import re
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, NamedTuple

from orchestrator.coordinator.journal.records import BadBackup, JournalError
from orchestrator.coordinator.journal.sql.inspection import JournalDamage
from orchestrator.coordinator.journal.sqlite.inspection import check_journal
from orchestrator.model.files.private_files import make_private_folder, sync_folder
from orchestrator.runtime.state.folder import ADAPTERS, JOURNAL, StateLock
from orchestrator.runtime.state.unpacking import ImportWishes, find_epoch, prepare_journal, unpack_file

REPLACED = "replaced-"  # with the time, the folder of a journal that an import has replaced
REMEDY_REPLACE = (
    "give another folder with --state, or --replace: the present journal is then kept in it beside the new one"
)


class ImportedState(NamedTuple):
    """What an import has done. replaced: the folder, or the schema, that keeps the journal of before. left_out: files
    of the backup that the folder had already. damages: records that cannot be read, in the file as in the journal.
    checked: a change of the file would have been seen."""

    epoch: int
    jobs: dict[str, int]
    replaced: str | None
    left_out: list[str]
    damages: list[JournalDamage]
    checked: bool = True


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
            has_checksum = unpack_file(source, str(file), fresh, wishes)
            epoch = find_epoch(fresh, [folder], wishes.seen)
            damages = prepare_journal(fresh / JOURNAL, file, epoch, wishes)
            jobs = check_journal(fresh / JOURNAL).jobs
            old_folder = _set_aside(folder, wishes.utc)
            left_out = move_files(fresh, folder)
        sync_folder(folder)
        old_name = None if old_folder is None else str(old_folder)
        return ImportedState(epoch, jobs, old_name, left_out, damages, has_checksum)
    finally:
        lock.release()


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


def move_files(fresh: Path, folder: Path) -> list[str]:
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
