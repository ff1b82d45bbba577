"""A backup of a state folder in one file: a tar with the journal, the points, the fleet, latches and adapters' stores.

The databases are copied by SQLite's backup, so that each is as it was at one instant, also while the fleet runs. The
journal is copied before the points that its jobs name, and both before the stores: an epoch in these may be newer. The
first member, `manifest.json`, states size and digest of each other one, so that a file that was cut off or changed is
noticed as a whole.
"""

import hashlib
import io
import os
import re
import shutil
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, Literal, NamedTuple

from pydantic import Field, ValidationError

from orchestrator.coordinator.journal.records import BadBackup
from orchestrator.coordinator.journal.sqlite.database import copy_database
from orchestrator.coordinator.journal.sqlite.portable import read_stored_epoch
from orchestrator.model.base import Int53, Model
from orchestrator.model.files.private_files import FILE_MODE, sync_folder, write_new_file
from orchestrator.runtime.state.folder import ADAPTERS, FLEET_FILE, JOURNAL

MANIFEST = "manifest.json"
DATABASES = (JOURNAL, f"{JOURNAL}-points")
LATCHES = "estop*.json"
_KNOWN = re.compile(
    rf"{JOURNAL}(-points)?|{FLEET_FILE}|estop[a-z0-9_-]*\.json|{ADAPTERS}/[a-z0-9_-]+\.(json(\.copy)?|estop)"
)
_MAX_MANIFEST = 1_000_000
_CHUNK = 1 << 20
AGAIN = "copy it again, or use another backup"


class BackupMember(Model):
    """A file of a backup. digest: sha256."""

    size: Int53 = Field(ge=0)
    digest: str


class BackupManifest(Model):
    """What a backup contains. epoch: of the journal. tutti: the version that made it."""

    schema_: Literal["tutti.backup/1"] = Field(default="tutti.backup/1", alias="schema")
    tutti: str
    utc: str
    epoch: Int53
    members: dict[str, BackupMember]


class BackupSource(NamedTuple):
    """What is backed up. folder: the state folder; None: the journal alone. copy_journal: copies the journal, and the
    points of scans, into a folder."""

    folder: Path | None
    copy_journal: Callable[[Path], None]


def find_source(folder: Path) -> BackupSource:
    """A state folder with its journal."""

    def copy_journal(copies: Path) -> None:
        for name in DATABASES:
            if (folder / name).exists():
                copy_database(folder / name, copies / name)

    return BackupSource(folder, copy_journal)


def write_backup(source: BackupSource, target: Path, tutti: str, utc: str) -> BackupManifest:
    """Write a backup to a file, which appears as a whole, private, and on disk. Raises `JournalError`, `OSError`."""
    with TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as scratch:
        copies = Path(scratch)
        source.copy_journal(copies)
        epoch = read_stored_epoch(copies / JOURNAL)
        if source.folder is not None:
            for path in _find_plain_files(source.folder):
                copy = copies / path.relative_to(source.folder)
                copy.parent.mkdir(exist_ok=True)
                shutil.copyfile(path, copy)
        names = [file_name for file_name in _order_files(copies) if file_name != MANIFEST]
        members = {name: _describe(copies / name) for name in names}
        manifest = BackupManifest(tutti=tutti, utc=utc, epoch=epoch, members=members)
        (copies / MANIFEST).write_bytes(manifest.to_json())
        with (
            write_new_file(target) as file,
            tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as tar,
        ):
            for file_name in (MANIFEST, *names):
                tar.add(copies / file_name, file_name, filter=_hide_owner)
        sync_folder(target.parent)
    return manifest


def _find_plain_files(folder: Path) -> Iterator[Path]:
    """Fleet, latches and stores of a state folder; a link in it is left out, as no process of a fleet makes one."""
    folders = [folder / FLEET_FILE, *sorted(folder.glob(LATCHES)), *sorted((folder / ADAPTERS).glob("*"))]
    for path in folders:
        if path.is_file() and not path.is_symlink() and _KNOWN.fullmatch(str(path.relative_to(folder))):
            yield path


def _order_files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def _describe(path: Path) -> BackupMember:
    with path.open("rb") as file:
        return BackupMember(size=path.stat().st_size, digest=hashlib.file_digest(file, "sha256").hexdigest())


def _hide_owner(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    entry.mode = FILE_MODE
    return entry


def unpack_backup(source: BinaryIO, name: str, folder: Path) -> BackupManifest:
    """Unpack a backup into an empty folder of this user's; every file of it is there then, and is what was written.

    name: of the backup, for messages. Raises `BadBackup`, `OSError`."""
    manifest = None
    try:
        with tarfile.open(fileobj=source, mode="r:") as tar:
            first = tar.next()
            if first is None or first.name != MANIFEST or not first.isreg() or first.size > _MAX_MANIFEST:
                raise _no_backup(name)
            manifest = _read_manifest(tar, first, name)
            missing_members = set(manifest.members)
            while (entry := tar.next()) is not None:
                known_member = manifest.members.get(entry.name)
                if entry.name not in missing_members or known_member is None or not entry.isreg() or entry.issparse():
                    raise BadBackup(f"{name}: {entry.name!r} does not belong into a backup", "make a new backup")
                _unpack_member(tar, entry, known_member, folder / entry.name)
                missing_members.discard(entry.name)
    except (tarfile.TarError, EOFError) as error:
        if manifest is None:
            raise _no_backup(name) from None
        raise BadBackup(f"{name}: it is cut off, or damaged ({error})", AGAIN) from None
    if missing_members:
        raise BadBackup(f"{name}: it is cut off before {min(missing_members)}", AGAIN)
    return manifest


def _read_manifest(tar: tarfile.TarFile, entry: tarfile.TarInfo, name: str) -> BackupManifest:
    try:
        manifest = BackupManifest.model_validate_json(_open_member(tar, entry).read())
    except ValidationError:
        raise _no_backup(name) from None
    odd = sorted(member for member in manifest.members if not _KNOWN.fullmatch(member))
    if odd or JOURNAL not in manifest.members:
        raise BadBackup(f"{name}: {odd[0] if odd else f'without {JOURNAL}'!r} in its manifest", "make a new backup")
    return manifest


def _unpack_member(tar: tarfile.TarFile, entry: tarfile.TarInfo, known: BackupMember, path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    found_hash, size = hashlib.sha256(), 0
    with _open_member(tar, entry) as member, path.open("xb") as file:
        while data := member.read(_CHUNK):
            found_hash.update(data)
            size += len(data)
            file.write(data)
        file.flush()
        os.fsync(file.fileno())
    path.chmod(FILE_MODE)
    if (size, found_hash.hexdigest()) != (known.size, known.digest):
        raise tarfile.ReadError(f"{entry.name} is not what was written")


def _open_member(tar: tarfile.TarFile, entry: tarfile.TarInfo) -> BinaryIO:
    member = tar.extractfile(entry)
    return io.BytesIO() if member is None else member  # pyright: ignore[reportReturnType] - regular files only


def _no_backup(name: str) -> BadBackup:
    text = f"{name}: it is neither a backup nor an export of a journal"
    return BadBackup(text, "give a file of `tutti journal backup` or `export`")
