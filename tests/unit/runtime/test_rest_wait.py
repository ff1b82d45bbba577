"""What a router says while its changed table waits for a fleet that rests."""

from orchestrator.runtime.services.router import SAY_AGAIN_S, RestWait

WORK = "at work: gantry"


def test_work_is_said_once_and_again_after_ten_minutes_with_what_ends_it() -> None:
    wait = RestWait()
    line = "the table has changed; it counts when the fleet is at rest (at work: gantry)"
    assert wait.describe(WORK, 100.0) == line
    assert wait.describe(WORK, 101.0) == "" == wait.describe(WORK, 99.0 + SAY_AGAIN_S)
    assert wait.describe(WORK, 100.0 + SAY_AGAIN_S) == f"{line}; waited for 10 min: end that work, or `tutti stop`"
    assert "(at work: stage)" in wait.describe("at work: stage", 101.0 + SAY_AGAIN_S)
    assert wait.describe("", 102.0 + SAY_AGAIN_S) == ""
