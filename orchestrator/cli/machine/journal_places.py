"""Where the journal of a fleet is: in its state folder, or in a database. Each does what the commands ask of it."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import fleet_option, state_option
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.extras import require_extra

if TYPE_CHECKING:
    from orchestrator.coordinator.journal.postgres.address import JournalAddress
    from orchestrator.coordinator.journal.postgres.journal import FleetDatabase
    from orchestrator.coordinator.journal.sql.inspection import JournalCheck
    from orchestrator.runtime.state.backup import BackupSource
    from orchestrator.runtime.state.restore import ImportedState
    from orchestrator.runtime.state.unpacking import ImportWishes


def place_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options `--state`, `--fleet` and `--journal`, as `find_place` takes them."""
    journal_option = click.option(
        "--journal",
        "address",
        metavar="ADDRESS",
        help="The journal in PostgreSQL, postgresql://USER@HOST,HOST/DATABASE; --state adds what is beside it.",
    )
    return journal_option(state_option(fleet_option("The fleet, if there are several.")(command)))


class JournalPlace(Protocol):
    """A journal. Methods raise `JournalError`, `UpFailed`, `OSError`."""

    @property
    def name(self) -> str:
        """What messages name it by."""
        ...

    @property
    def folder_name(self) -> str:
        """What messages name it with all that is beside it by."""
        ...

    @property
    def newest_schema(self) -> int: ...

    def check(self) -> "JournalCheck": ...

    def export(self, tutti: str, utc: str, write: Callable[[str], object]) -> int: ...

    def find_source(self) -> "BackupSource": ...

    def import_file(self, file: Path, wishes: "ImportWishes") -> "ImportedState": ...


class StateFolder:
    """A journal in a state folder."""

    def __init__(self, folder: Path) -> None:
        from orchestrator.runtime.state.folder import JOURNAL

        self._folder = folder
        self._path = folder / JOURNAL

    @property
    def name(self) -> str:
        return str(self._path)

    @property
    def folder_name(self) -> str:
        return str(self._folder)

    @property
    def newest_schema(self) -> int:
        from orchestrator.coordinator.journal.sqlite.schema import VERSION

        return VERSION

    def check(self) -> "JournalCheck":
        from orchestrator.coordinator.journal.sqlite.inspection import check_journal

        return check_journal(self._path)

    def export(self, tutti: str, utc: str, write: Callable[[str], object]) -> int:
        from orchestrator.coordinator.journal.sqlite.portable import export_journal

        return export_journal(self._path, tutti, utc, write)

    def find_source(self) -> "BackupSource":
        from orchestrator.runtime.state.backup import find_source

        return find_source(self._folder)

    def import_file(self, file: Path, wishes: "ImportWishes") -> "ImportedState":
        from orchestrator.runtime.state.restore import import_state

        return import_state(file, self._folder, wishes)


class DatabaseJournal:
    """A journal in a database. folder: the state folder of a computer of its fleet, if there is one."""

    def __init__(self, database: "FleetDatabase", folder: Path | None) -> None:
        self._database = database
        self._folder = folder

    @property
    def name(self) -> str:
        return f"{self._database.address.text}, fleet {self._database.fleet}"

    @property
    def folder_name(self) -> str:
        return self.name

    @property
    def newest_schema(self) -> int:
        from orchestrator.coordinator.journal.postgres.schema import VERSION

        return VERSION

    def check(self) -> "JournalCheck":
        from orchestrator.coordinator.journal.postgres.tools import check_database

        return check_database(self._database)

    def export(self, tutti: str, utc: str, write: Callable[[str], object]) -> int:
        from orchestrator.coordinator.journal.postgres.tools import export_database

        return export_database(self._database, tutti, utc, write)

    def find_source(self) -> "BackupSource":
        from orchestrator.runtime.state.database import find_database_source

        return find_database_source(self._database, self._folder)

    def import_file(self, file: Path, wishes: "ImportWishes") -> "ImportedState":
        from orchestrator.runtime.state.database import import_into_database

        return import_into_database(file, self._database, self._folder, wishes)


def find_place(state: Path | None, fleet: str | None, address: str | None) -> JournalPlace:
    """The journal that a command means; ends it without one, or with several. Raises `JournalError`."""
    if address is not None:
        return _find_database(state, fleet, address)
    from orchestrator.runtime.state.folder import JOURNAL, default_state

    if state is not None or fleet is not None:
        path = (state or default_state(fleet or "")) / JOURNAL
        if not path.exists():
            exit_with_error(f"{path}: there is no journal", BAD_INPUT, "name the folder of `tutti up` with --state")
        return StateFolder(path.parent)
    state_folder = default_state("any").parent
    folders = sorted(path.parent for path in state_folder.glob(f"*/{JOURNAL}"))
    if not folders:
        exit_with_error(f"{state_folder}: there is no journal of a fleet", BAD_INPUT, "name its folder with --state")
    if len(folders) > 1:
        names = ", ".join(folder.name for folder in folders)
        exit_with_error(f"several fleets have a journal: {names}", BAD_INPUT, "choose one with --fleet or --state")
    return StateFolder(folders[0])


def find_target(state: Path | None, fleet: str | None, address: str | None) -> JournalPlace:
    """Where a journal is imported to, which need not be there; ends the command if that is not said."""
    if address is not None:
        if fleet is None:
            exit_with_error("the fleet is missing", BAD_INPUT, "name it with --fleet: a database may have several")
        return _find_database(state, fleet, address)
    from orchestrator.runtime.state.folder import default_state

    if state is None and fleet is None:
        exit_with_error("the state folder is missing", BAD_INPUT, "name it with --state, or --fleet for its usual one")
    return StateFolder(state or default_state(fleet or ""))


def read_database_address(text: str) -> "JournalAddress":
    """The address of a database as a command takes it; ends it for one that cannot be read, or without the extra."""
    require_extra("postgres")
    from orchestrator.coordinator.journal.postgres.address import read_address
    from orchestrator.coordinator.journal.records import JournalError

    try:
        return read_address(text)
    except JournalError as error:
        exit_with_error(error.text, BAD_INPUT, error.remedy)


def _find_database(state: Path | None, fleet: str | None, address: str) -> JournalPlace:
    known_address = read_database_address(address)
    from orchestrator.coordinator.journal.postgres.journal import FleetDatabase
    from orchestrator.coordinator.journal.postgres.tools import find_fleets

    if fleet is None:
        fleets = find_fleets(known_address)
        if not fleets:
            exit_with_error(f"{known_address.text}: there is no journal of a fleet", BAD_INPUT, "give another address")
        if len(fleets) > 1:
            text = f"several fleets have a journal: {', '.join(fleets)}"
            exit_with_error(text, BAD_INPUT, "choose one with --fleet")
        fleet = fleets[0]
    return DatabaseJournal(FleetDatabase(known_address, fleet), state)
