"""An address with several hosts: those that are silent or refuse are asked last."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from time import monotonic

import pytest

pytest.importorskip("psycopg")
from psycopg.conninfo import conninfo_to_dict

from orchestrator.coordinator.journal.postgres.reach import put_living_first, takes_connections

LIMIT_S = 0.2


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def listen(stack: ExitStack) -> str:
    return str(stack.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1])


def be_silent(stack: ExitStack) -> str:
    """A port that answers no further connection, as a computer that is dead: its queue is full."""
    server = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
    for _ in range(3):
        client = stack.enter_context(socket.socket())
        client.settimeout(0)
        client.connect_ex(server.getsockname())
    return str(server.getsockname()[1])


def order(ports: list[str], hosts: str = "") -> list[str]:
    hosts = hosts or ",".join(["127.0.0.1"] * len(ports))
    conninfo = put_living_first(f"host={hosts} port={','.join(ports)} dbname=x connect_timeout=2", LIMIT_S)
    parts = conninfo_to_dict(conninfo)
    assert parts["dbname"] == "x" and parts["connect_timeout"] == "2"
    return str(parts["port"]).split(",")


def test_hosts_that_take_connections_come_first_in_their_order(stack: ExitStack) -> None:
    silent, first, second = be_silent(stack), listen(stack), listen(stack)
    with socket.create_server(("127.0.0.1", 0)) as closing:
        refused = str(closing.getsockname()[1])
    began_s = monotonic()
    assert order([silent, first, refused, second]) == [first, second, silent, refused]
    assert LIMIT_S <= monotonic() - began_s < LIMIT_S + 1
    # Without one that is silent nothing is waited for.
    began_s = monotonic()
    assert order([refused, second, first]) == [second, first, refused]
    assert monotonic() - began_s < LIMIT_S


def test_an_address_whose_hosts_cannot_be_asked_stays_as_it_is(stack: ExitStack) -> None:
    port = listen(stack)
    assert order([port]) == [port]
    assert put_living_first("dbname=x", LIMIT_S) == "dbname=x"
    assert put_living_first("host=a,b hostaddr=127.0.0.1,127.0.0.2", LIMIT_S).count("hostaddr") == 1
    # One port for all; a name that is none; a folder of a local socket, which is there.
    parts = conninfo_to_dict(put_living_first(f"host=a..b,127.0.0.1,/tmp port={port}", LIMIT_S))
    assert parts["host"] == "127.0.0.1,/tmp,a..b"


def test_a_host_that_is_dead_is_not_waited_for(stack: ExitStack) -> None:
    assert takes_connections(f"host=127.0.0.1 port={listen(stack)}", LIMIT_S)
    assert not takes_connections(f"host=127.0.0.1 port={be_silent(stack)}", LIMIT_S)
    assert takes_connections("dbname=x", LIMIT_S)
