"""`tutti journal …`: check, back up, export and import the journal of a fleet."""

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import (
    actor_name,
    check_endpoint_option,
    console,
    json_option,
    print_json,
    print_result,
    with_fleet,
)
from orchestrator.cli.base.errors import exit_with_error, expected_errors
from orchestrator.cli.machine.journal_places import find_place, find_target, place_options

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.runtime.state.restore import ImportedState

OUTPUT = click.Path(path_type=Path, dir_okay=False)


@click.group(epilog="Example: tutti journal backup -o lab.backup.tar --fleet lab")
def journal() -> None:
    """The journal of a fleet, in its state folder or in PostgreSQL: accepted jobs, decisions, reports, positions,
    alarms."""


@journal.command(epilog="Example: tutti journal check --fleet lab")
@place_options
@json_option
def check(state: Path | None, fleet: str | None, address: str | None, *, as_json: bool) -> None:
    """Check the journal: its file, if it is one, and every record in it. Nothing is changed, and the fleet may run.

    Exit 1 if something is damaged.
    """
    with _journal_errors():
        source = find_place(state, fleet, address)
        journal_check = source.check()
    if as_json:
        damages = [damage._asdict() for damage in journal_check.damages]
        fields = {"schema": journal_check.schema, "epoch": journal_check.epoch, "jobs": journal_check.jobs}
        print_json({"journal": source.name, **fields, "damages": damages})
    else:
        schema = f"schema {journal_check.schema}"
        if journal_check.schema < source.newest_schema:
            schema += f", which becomes {source.newest_schema} at the next start of the fleet"
        jobs = ", ".join(f"{count} {name}" for name, count in journal_check.jobs.items()) or "none"
        epoch = "damaged" if journal_check.epoch is None else journal_check.epoch
        lines = [f"{source.name}: {schema}; epoch {epoch}; jobs: {jobs}"]
        lines += [f"damaged: {damage.place}: {damage.problem}\n  {damage.remedy}" for damage in journal_check.damages]
        lines += [] if journal_check.damages else ["no damage found"]
        _print_lines(lines)
    if journal_check.damages:
        raise SystemExit(FAILED)


@journal.command(epilog="Example: tutti journal backup -o lab.backup.tar --fleet lab")
@place_options
@click.option("-o", "--output", type=OUTPUT, required=True, help="The file to write.")
@click.option("--force", is_flag=True, help="Overwrite the file.")
@json_option
def backup(
    state: Path | None, fleet: str | None, address: str | None, output: Path, *, force: bool, as_json: bool
) -> None:
    """Write a backup of the state folder to one file: journal, points of scans, fleet, e-stop latches, and what
    adapters keep. The fleet may run. With --journal, of the database, and of the folder of --state if it is given.
    """
    from orchestrator.model.version import find_own_version
    from orchestrator.runtime.state.backup import write_backup

    _refuse_existing(output, force=force)
    with _journal_errors(), expected_errors():
        source = find_place(state, fleet, address)
        manifest = write_backup(source.find_source(), output, find_own_version(), _utc())
    size = sum(member.size for member in manifest.members.values())
    value = {"file": str(output), "epoch": manifest.epoch, "members": sorted(manifest.members)}
    words = (
        f"{output}: {len(manifest.members)} files of {source.folder_name}, {size / 1e6:.1f} MB, epoch {manifest.epoch}"
    )
    print_result(value, words, as_json=as_json)


@journal.command(epilog="Example: tutti journal export -o lab.jsonl --fleet lab")
@place_options
@click.option("-o", "--output", type=OUTPUT, required=True, help="The file to write.")
@click.option("--force", is_flag=True, help="Overwrite the file.")
@json_option
def export(
    state: Path | None, fleet: str | None, address: str | None, output: Path, *, force: bool, as_json: bool
) -> None:
    """Write the journal as text, one record a line, for programs and for moving it. The fleet may run."""
    from orchestrator.model.files.private_files import write_new_file
    from orchestrator.model.version import find_own_version

    _refuse_existing(output, force=force)
    with _journal_errors():
        source = find_place(state, fleet, address)
        with write_new_file(output) as file:
            count = source.export(find_own_version(), _utc(), lambda text: file.write(text.encode()))
    print_result({"file": str(output), "records": count}, f"{output}: {count} records", as_json=as_json)


@journal.command(
    "import", epilog="Example: tutti journal import lab.backup.tar --state ~/.local/state/tutti/lab --replace"
)
@click.argument("file", type=click.Path(path_type=Path, exists=True))
@place_options
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
    address: str | None,
    *,
    replace: bool,
    require_checksum: bool,
    connect: str,
    as_json: bool,
) -> None:
    """Bring a backup or an export back into a state folder with which no fleet runs, or into a database.

    The epoch becomes higher than that of the file, of the adapters' files there, and of the controllers at --connect.
    Files of a backup that the folder has already stay as they are, except the journal with --replace. The queue is
    stopped: jobs that were waiting may have run since; see `tutti queue`.
    """
    from orchestrator.runtime.state.unpacking import ImportWishes

    epochs = with_fleet(connect, fleet, _find_epochs) if connect else {}
    with _journal_errors(), expected_errors():
        target = find_target(state, fleet, address)
        wishes = ImportWishes(actor_name(), _utc(), replace, require_checksum, tuple(epochs.values()))
        result = target.import_file(file, wishes)
    if as_json:
        damages = [damage._asdict() for damage in result.damages]
        fields = {"epoch": result.epoch, "jobs": result.jobs, "replaced": result.replaced, "left_out": result.left_out}
        fields["checked"] = result.checked
        print_json({"state": target.folder_name, **fields, "controllers": epochs, "damages": damages})
        return
    _print_lines(_describe_import(target.folder_name, result, epochs))


def _describe_import(place: str, result: "ImportedState", epochs: Mapping[str, int]) -> list[str]:
    jobs = ", ".join(f"{count} {name}" for name, count in result.jobs.items()) or "none"
    lines = [f"{place}: imported; epoch {result.epoch}; jobs: {jobs}"]
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
