"""Controllers that answer anything: no error but the expected ones, no hang, no motion that was not released."""

import pytest
from adapter_worlds import CASES

from orchestrator.conformance.wire_fuzz import run_conversation

MAKES = ("smc4000", "smc2000", "shrc203", "smc30", "ppsmc", "cia402")
CONVERSATIONS, NIGHTLY = 12, 2500  # of each make


def cases(make: str) -> list[str]:
    return [name for name in CASES if name.startswith(make)]


def converse(make: str, seeds: range) -> None:
    names = cases(make)
    ends: dict[str, int] = {}
    for seed in seeds:
        name = names[seed % len(names)]
        try:
            ended = run_conversation(name, CASES[name], seed)
        except Exception as error:
            raise AssertionError(f"{name}, seed {seed}: {error!r}") from error
        kind = ended.partition(":")[0]
        ends[kind] = ends.get(kind, 0) + 1
    assert ends.get("ControllerFault", 0) > 0, ends


@pytest.mark.parametrize("make", MAKES)
def test_replies_that_are_wrong_end_in_faults_only(make: str) -> None:
    converse(make, range(CONVERSATIONS))


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("make", MAKES)
def test_many_replies_that_are_wrong_end_in_faults_only(make: str) -> None:
    converse(make, range(CONVERSATIONS, NIGHTLY))
