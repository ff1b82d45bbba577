"""Keys of a fleet, key expressions, and the modules that may import Zenoh."""

import random
import subprocess
import sys

import pytest
import zenoh

from orchestrator.bus.expression import check_expression, check_key, expressions_intersect
from orchestrator.bus.keys import FleetKeys

KEYS = FleetKeys("lab-1")


def test_keys_are_those_of_the_table() -> None:
    built = {
        KEYS.state("x"): "ctl/x/state",
        KEYS.event("x"): "ctl/x/event",
        KEYS.info("x"): "ctl/x/info",
        KEYS.clock("x"): "ctl/x/clock",
        KEYS.command("x", "arm"): "ctl/x/cmd/arm",
        KEYS.lease("x"): "lease/x",
        KEYS.lease("x", "a"): "lease/x/a",
        KEYS.job_state("7"): "job/7/state",
        KEYS.job_report("7"): "job/7/report",
        KEYS.queue: "queue",
        KEYS.service("submit"): "svc/submit",
        KEYS.time: "time",
        KEYS.leader: "leader",
        KEYS.estop: "estop",
        KEYS.log("adapter", "x"): "log/adapter/x",
        KEYS.live("adapter", "x", "9f"): "live/adapter/x/9f",
    }
    for key, tail in built.items():
        assert key == f"tutti/v1/lab-1/{tail}"
        assert check_key(key) == key


def test_an_omitted_part_matches_all() -> None:
    assert KEYS.state() == "tutti/v1/lab-1/ctl/*/state"
    for wide, key in (
        (KEYS.command("x"), KEYS.command("x", "arm")),
        (KEYS.command(), KEYS.command("x", "arm")),
        (KEYS.leases, KEYS.lease("x")),
        (KEYS.leases, KEYS.lease("x", "a")),
        (KEYS.live("adapter"), KEYS.live("adapter", "x", "1")),
        (KEYS.log(), KEYS.log("adapter", "x")),
        (KEYS.job_state(), KEYS.job_state("7")),
    ):
        assert expressions_intersect(check_expression(wide), key)


def test_keys_are_read_back() -> None:
    assert KEYS.verb_of(KEYS.command("x", "arm")) == "arm"
    assert KEYS.verb_of(KEYS.service("submit")) == "submit"


@pytest.mark.parametrize("id", ["", "X", "a/b", "a b", "*", "ä", "a\n"])
def test_an_id_that_cannot_be_one_is_refused(id: str) -> None:
    with pytest.raises(ValueError, match="allowed are a-z"):
        KEYS.state(id)
    with pytest.raises(ValueError, match="allowed are a-z"):
        KEYS.lease("x", id)
    with pytest.raises(ValueError, match="fleet"):
        FleetKeys(id)


@pytest.mark.parametrize("key", [FleetKeys("other").state("x"), KEYS.queue, "ctl/x/state", KEYS.prefix])
def test_a_foreign_key_is_not_parsed(key: str) -> None:
    with pytest.raises(ValueError, match=r"not a key of|not of fleet"):
        KEYS.verb_of(key)


def test_a_state_key_has_no_verb() -> None:
    with pytest.raises(ValueError, match="not a command"):
        KEYS.verb_of(KEYS.state("x"))


def test_key_expressions_intersect_as_in_zenoh() -> None:
    draw = random.Random(1)
    for _ in range(3000):
        one, other = (
            "/".join(draw.choice(["a", "b", "*", "**"]) for _ in range(draw.randrange(1, 6))) for _ in range(2)
        )
        theirs = zenoh.KeyExpr.autocanonize(one).intersects(zenoh.KeyExpr.autocanonize(other))
        assert expressions_intersect(one, other) == theirs, (one, other)


def test_only_the_live_bus_imports_zenoh() -> None:
    program = "import orchestrator.bus.keys, orchestrator.bus.memory.bus, sys; sys.exit('zenoh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
