"""Keys of a fleet, key expressions, and who may know Zenoh."""

import random
import subprocess
import sys

import pytest
import zenoh

from orchestrator.bus.expression import check_expression, check_key, intersects
from orchestrator.bus.keys import Keys

KEYS = Keys("lab-1")


def test_keys_are_those_of_the_table() -> None:
    built = {
        KEYS.state("x"): "ctl/x/state",
        KEYS.event("x"): "ctl/x/event",
        KEYS.info("x"): "ctl/x/info",
        KEYS.clock("x"): "ctl/x/clock",
        KEYS.cmd("x", "arm"): "ctl/x/cmd/arm",
        KEYS.lease("x"): "lease/x",
        KEYS.lease("x", "a"): "lease/x/a",
        KEYS.job_state("7"): "job/7/state",
        KEYS.job_report("7"): "job/7/report",
        KEYS.queue: "queue",
        KEYS.svc("submit"): "svc/submit",
        KEYS.time: "time",
        KEYS.leader: "leader",
        KEYS.estop: "estop",
        KEYS.log("adapter", "x"): "log/adapter/x",
        KEYS.live("adapter", "x", "9f"): "live/adapter/x/9f",
    }
    for key, tail in built.items():
        assert key == f"tutti/v1/lab-1/{tail}"
        assert check_key(key) == key


def test_what_is_left_out_stands_for_all() -> None:
    assert KEYS.state() == "tutti/v1/lab-1/ctl/*/state"
    for wide, key in (
        (KEYS.cmd("x"), KEYS.cmd("x", "arm")),
        (KEYS.cmd(), KEYS.cmd("x", "arm")),
        (KEYS.leases, KEYS.lease("x")),
        (KEYS.leases, KEYS.lease("x", "a")),
        (KEYS.live("adapter"), KEYS.live("adapter", "x", "1")),
        (KEYS.log(), KEYS.log("adapter", "x")),
        (KEYS.job_state(), KEYS.job_state("7")),
    ):
        assert intersects(check_expression(wide), key)


def test_keys_are_read_back() -> None:
    assert KEYS.verb_of(KEYS.cmd("x", "arm")) == "arm"
    assert KEYS.verb_of(KEYS.svc("submit")) == "submit"


@pytest.mark.parametrize("id", ["", "X", "a/b", "a b", "*", "ä", "a\n"])
def test_an_id_that_cannot_be_one_is_refused(id: str) -> None:
    with pytest.raises(ValueError, match="allowed are a-z"):
        KEYS.state(id)
    with pytest.raises(ValueError, match="allowed are a-z"):
        KEYS.lease("x", id)
    with pytest.raises(ValueError, match="fleet"):
        Keys(id)


@pytest.mark.parametrize("key", [Keys("other").state("x"), KEYS.queue, "ctl/x/state", KEYS.prefix])
def test_a_key_of_something_else_is_not_read(key: str) -> None:
    with pytest.raises(ValueError, match=r"not a key of|not of fleet"):
        KEYS.verb_of(key)


def test_a_state_key_has_no_verb() -> None:
    with pytest.raises(ValueError, match="not a command"):
        KEYS.verb_of(KEYS.state("x"))


def test_expressions_meet_as_zenoh_says() -> None:
    draw = random.Random(1)
    for _ in range(3000):
        one, other = (
            "/".join(draw.choice(["a", "b", "*", "**"]) for _ in range(draw.randrange(1, 6))) for _ in range(2)
        )
        theirs = zenoh.KeyExpr.autocanonize(one).intersects(zenoh.KeyExpr.autocanonize(other))
        assert intersects(one, other) == theirs, (one, other)


def test_only_the_live_bus_knows_zenoh() -> None:
    program = "import orchestrator.bus.keys, orchestrator.bus.memory.bus, sys; sys.exit('zenoh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
