"""`tutti journal …`: check, back up, export and import the journal of a fleet."""

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import (
    actor_name,
    check_endpoint_option,
    console,
    fleet_option,
    json_option,
    print_json,
    print_result,
    state_option,
    with_fleet,
)
from orchestrator.cli.base.errors import exit_with_error, expected_errors

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.runtime.state.restore import ImportedState

OUTPUT = click.Path(path_type=Path, dir_okay=False)


@click.group(epilog="Example: tutti journal backup -o lab.backup.tar --fleet lab")
def journal() -> None:
    """The journal of a fleet, in its state folder: accepted jobs, decisions, reports, positions, alarms."""


def _folder_options(command: Callable[..., Any]) -> Callable[..., Any]:
    return state_option(fleet_option("The fleet, if there are several state folders.")(command))


@journal.command(epilog="Example: tutti journal check --fleet lab")
@_folder_options
@json_option
def check(state: Path | None, fleet: str | None, *, as_json: bool) -> None:
    """Check the journal: its file, and every record in it. Nothing is changed, and the fleet may run.

    Exit 1 if something is damaged.
    """
    from orchestrator.coordinator.journal.sqlite.inspection import check_journal
    from orchestrator.coordinator.journal.sqlite.schema import VERSION

    path = _find_journal(state, fleet)
    with _journal_errors():
        journal_check = check_journal(path)
    if as_json:
        damages = [damage._asdict() for damage in journal_check.damages]
        fields = {"schema": journal_check.schema, "epoch": journal_check.epoch, "jobs": journal_check.jobs}
        print_json({"journal": str(path), **fields, "damages": damages})
    else:
        schema = f"schema {journal_check.schema}"
        if journal_check.schema < VERSION:
            schema += f", which becomes {VERSION} at the next start of the fleet"
        jobs = ", ".join(f"{count} {name}" for name, count in journal_check.jobs.items()) or "none"
        epoch = "damaged" if journal_check.epoch is None else journal_check.epoch
        lines = [f"{path}: {schema}; epoch {epoch}; jobs: {jobs}"]
        lines += [f"damaged: {damage.place}: {damage.problem}\n  {damage.remedy}" for damage in journal_check.damages]
        lines += [] if journal_check.damages else ["no damage found"]
        _print_lines(lines)
    if journal_check.damages:
        raise SystemExit(FAILED)


@journal.command(epilog="Example: tutti journal backup -o lab.backup.tar --fleet lab")
@_folder_options
@click.option("-o", "--output", type=OUTPUT, required=True, help="The file to write.")
@click.option("--force", is_flag=True, help="Overwrite the file.")
@json_option
def backup(state: Path | None, fleet: str | None, output: Path, *, force: bool, as_json: bool) -> None:
    """Write a backup of the state folder to one file: journal, points of scans, fleet, e-stop latches, and what
    adapters keep. The fleet may run.
    """
    from orchestrator.model.version import find_own_version
    from orchestrator.runtime.state.backup import write_backup

    folder = _find_journal(state, fleet).parent
    _refuse_existing(output, force=force)
    with _journal_errors(), expected_errors():
        manifest = write_backup(folder, output, find_own_version(), _utc())
    size = sum(member.size for member in manifest.members.values())
    value = {"file": str(output), "epoch": manifest.epoch, "members": sorted(manifest.members)}
    words = f"{output}: {len(manifest.members)} files of {folder}, {size / 1e6:.1f} MB, epoch {manifest.epoch}"
    print_result(value, words, as_json=as_json)


@journal.command(epilog="Example: tutti journal export -o lab.jsonl --fleet lab")
@_folder_options
@click.option("-o", "--output", type=OUTPUT, required=True, help="The file to write.")
@click.option("--force", is_flag=True, help="Overwrite the file.")
@json_option
def export(state: Path | None, fleet: str | None, output: Path, *, force: bool, as_json: bool) -> None:
    """Write the journal as text, one record a line, for programs and for moving it. The fleet may run."""
    from orchestrator.coordinator.journal.sqlite.portable import export_journal
    from orchestrator.model.files.private_files import write_new_file
    from orchestrator.model.version import find_own_version

    path = _find_journal(state, fleet)
    _refuse_existing(output, force=force)
    with _journal_errors(), write_new_file(output) as file:
        count = export_journal(path, find_own_version(), _utc(), lambda text: file.write(text.encode()))
    print_result({"file": str(output), "records": count}, f"{output}: {count} records", as_json=as_json)


@journal.command(
    "import", epilog="Example: tutti journal import lab.backup.tar --state ~/.local/state/tutti/lab --replace"
)
@click.argument("file", type=click.Path(path_type=Path, exists=True))
@_folder_options
@click.option("--replace", is_flag=True, help="Replace a journal that is there; it is kept in a folder beside.")
@click.option(
    "--require-checksum", is_flag=True, help="Refuse an export of an earlier version, in which no change can be seen."
)
@click.option(
    "--connect", default="", callback=check_endpoint_option, help="Ask controllers at this router for their epochs."
)
@json_option
def import_(
    file: Path,
    state: Path | None,
    fleet: str | None,
    *,
    replace: bool,
    require_checksum: bool,
    connect: str,
    as_json: bool,
) -> None:
    """Bring a backup or an export back into a state folder with which no fleet runs.

    The epoch becomes higher than that of the file, of the adapters' files there, and of the controllers at --connect.
    Files of a backup that the folder has already stay as they are, except the journal with --replace. The queue is
    stopped: jobs that were waiting may have run since; see `tutti queue`.
    """
    from orchestrator.runtime.state.folder import default_state
    from orchestrator.runtime.state.restore import ImportWishes, import_state

    if state is None and fleet is None:
        exit_with_error("the state folder is missing", BAD_INPUT, "name it with --state, or --fleet for its usual one")
    folder = state or default_state(fleet or "")
    epochs = with_fleet(connect, fleet, _find_epochs) if connect else {}
    with _journal_errors(), expected_errors():
        wishes = ImportWishes(actor_name(), _utc(), replace, require_checksum, tuple(epochs.values()))
        result = import_state(file, folder, wishes)
    if as_json:
        damages = [damage._asdict() for damage in result.damages]
        copy_path = None if result.replaced is None else str(result.replaced)
        fields = {"epoch": result.epoch, "jobs": result.jobs, "replaced": copy_path, "left_out": result.left_out}
        fields["checked"] = result.checked
        print_json({"state": str(folder), **fields, "controllers": epochs, "damages": damages})
        return
    _print_lines(_describe_import(folder, result, epochs))


def _describe_import(folder: Path, result: "ImportedState", epochs: Mapping[str, int]) -> list[str]:
    jobs = ", ".join(f"{count} {name}" for name, count in result.jobs.items()) or "none"
    lines = [f"{folder}: imported; epoch {result.epoch}; jobs: {jobs}"]
    lines += [] if result.checked else ["the export is of an earlier version: a change in it could not be seen"]
    lines += [f"the journal of before is in {result.replaced}"] if result.replaced else []
    lines += [f"left as it was in the folder: {', '.join(result.left_out)}"] if result.left_out else []
    lines += (
        [f"epochs of controllers: {', '.join(f'{name} {epoch}' for name, epoch in epochs.items())}"] if epochs else []
    )
    lines += [f"damaged: {damage.place}: {damage.problem}\n  {damage.remedy}" for damage in result.damages]
    return [*lines, "the queue is stopped: look which jobs still have to run, then `tutti queue start`"]


async def _find_epochs(tutti: "Tutti") -> dict[str, int]:
    """The epochs of the controllers that answer."""
    return {name: state.epoch for name, state in (await tutti.status()).items()}


def _find_journal(state: Path | None, fleet: str | None) -> Path:
    """The journal that a command means; ends it without one, or with several."""
    from orchestrator.runtime.state.folder import JOURNAL, default_state

    if state is not None or fleet is not None:
        path = (state or default_state(fleet or "")) / JOURNAL
        if not path.exists():
            exit_with_error(f"{path}: there is no journal", BAD_INPUT, "name the folder of `tutti up` with --state")
        return path
    state_folder = default_state("any").parent
    journals = sorted(state_folder.glob(f"*/{JOURNAL}"))
    if not journals:
        exit_with_error(f"{state_folder}: there is no journal of a fleet", BAD_INPUT, "name its folder with --state")
    if len(journals) > 1:
        names = ", ".join(path.parent.name for path in journals)
        exit_with_error(f"several fleets have a journal: {names}", BAD_INPUT, "choose one with --fleet or --state")
    return journals[0]


def _refuse_existing(output: Path, *, force: bool) -> None:
    if output.exists() and not force:
        exit_with_error(f"{output} exists", BAD_INPUT, "choose another file, or overwrite it with --force")


@contextmanager
def _journal_errors() -> Generator[None]:
    """Turn what is wrong with a journal, a file or a disk into a message and an exit code."""
    from orchestrator.coordinator.journal.records import BadBackup, JournalError

    try:
        yield
    except JournalError as error:
        exit_code = BAD_INPUT if isinstance(error, BadBackup) else FAILED
        exit_with_error(error.text, exit_code, error.remedy, code="journal")
    except OSError as error:
        path = error.filename or "the file"
        exit_with_error(f"{path}: {error.strerror}", FAILED, "choose another place, or free space there", code="disk")


def _utc() -> str:
    from datetime import UTC, datetime

    from orchestrator.model.queue import format_utc

    return format_utc(datetime.now(UTC))


def _print_lines(lines: list[str]) -> None:
    console.print("\n".join(lines), highlight=False, markup=False, soft_wrap=True)
