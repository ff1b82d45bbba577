"""Of several routers the first session tries those first that take connections."""

import json
from contextlib import ExitStack

import pytest
import zenoh
from unit.silent_ports import be_silent, listen, refuse

from orchestrator.bus.endpoint import find_host
from orchestrator.bus.hosts_live import Host
from orchestrator.bus.zenoh.sessions import open_session


class EnoughError(Exception):
    """The test has seen what it needs."""


@pytest.mark.parametrize(
    ("endpoint", "host"),
    [
        ("tcp/lab-a:7447", Host("lab-a", "7447")),
        ("tls/[::1]:7447?iface=lo", Host("::1", "7447")),
        ("unixsock-stream//run/tutti", Host("/run/tutti")),
        ("udp/127.0.0.1:7447", None),
    ],
)
def test_where_a_router_takes_connections(endpoint: str, host: Host | None) -> None:
    assert find_host(endpoint) == host


def test_a_router_whose_computer_is_dead_is_tried_last(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[tuple[list[str], int]] = []

    def fail(config: zenoh.Config) -> zenoh.Session:
        tried.append(
            (json.loads(config.get_json("connect/endpoints")), json.loads(config.get_json("connect/timeout_ms")))
        )
        if len(tried) == 3:
            raise EnoughError
        raise zenoh.ZError("nothing answers")

    monkeypatch.setattr(zenoh, "open", fail)
    with ExitStack() as stack:
        dead, gone, first, second = (
            f"tcp/127.0.0.1:{port}" for port in (be_silent(stack), refuse(), listen(stack), listen(stack))
        )
        with pytest.raises(EnoughError):
            open_session(f"{dead},{first},{gone},{second}")
    # Those that take connections by turns, each for longer than the time before.
    assert [endpoints[:2] for endpoints, _ in tried[:3]] == [[first, second], [second, first], [first, second]]
    assert [sorted(endpoints[2:]) for endpoints, _ in tried[:3]] == [sorted([dead, gone])] * 3
    assert tried[0][1] < tried[1][1]
