"""An address with several hosts: those that are silent or refuse are asked last."""

from collections.abc import Iterator
from contextlib import ExitStack
from time import monotonic

import pytest

pytest.importorskip("psycopg")
from psycopg.conninfo import conninfo_to_dict
from unit.silent_ports import be_silent, listen, refuse

from orchestrator.coordinator.journal.postgres.reach import put_living_first, takes_connections

LIMIT_S = 0.2


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def order(*ports: int) -> list[int]:
    hosts, listed = ",".join(["127.0.0.1"] * len(ports)), ",".join(map(str, ports))
    conninfo = put_living_first(f"host={hosts} port={listed} dbname=x connect_timeout=2", LIMIT_S)
    parts = conninfo_to_dict(conninfo)
    assert parts["dbname"] == "x" and parts["connect_timeout"] == "2"
    return [int(port) for port in str(parts["port"]).split(",")]


def test_hosts_that_take_connections_come_first_in_their_order(stack: ExitStack) -> None:
    silent, first, second, refused = be_silent(stack), listen(stack), listen(stack), refuse()
    began_s = monotonic()
    assert order(silent, first, refused, second) == [first, second, silent, refused]
    assert LIMIT_S <= monotonic() - began_s < LIMIT_S + 1
    # Without one that is silent nothing is waited for.
    began_s = monotonic()
    assert order(refused, second, first) == [second, first, refused]
    assert monotonic() - began_s < LIMIT_S


def test_an_address_whose_hosts_cannot_be_asked_stays_as_it_is(stack: ExitStack) -> None:
    port = listen(stack)
    assert order(port) == [port]
    assert put_living_first("dbname=x", LIMIT_S) == "dbname=x"
    assert put_living_first("host=a,b hostaddr=127.0.0.1,127.0.0.2", LIMIT_S).count("hostaddr") == 1
    # One port for all; a name that is none; a folder of a local socket, which is there.
    parts = conninfo_to_dict(put_living_first(f"host=a..b,127.0.0.1,/tmp port={port}", LIMIT_S))
    assert parts["host"] == "127.0.0.1,/tmp,a..b"


def test_a_host_that_is_dead_is_not_waited_for(stack: ExitStack) -> None:
    assert takes_connections(f"host=127.0.0.1 port={listen(stack)}", LIMIT_S)
    assert not takes_connections(f"host=127.0.0.1 port={be_silent(stack)}", LIMIT_S)
    assert takes_connections("dbname=x", LIMIT_S)
