"""Background tasks have an owner: `orchestrator/clock/owner.py` starts them, and notices how each ends."""

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[3]
PACKAGES = ("tutti", "orchestrator", "adapters", "sim", "integrations")
START = re.compile(r"\b(?:create_task|ensure_future)\(")

CLOCK = "it makes the tasks of all others"
RESULT = "the result, or the error, of each is awaited where it is used"
LOCAL = "awaited or cancelled in the same function"
# Not cancelled when its caller is: a job whose id is unknown cannot be stopped.
UNCUT = "a submission that its caller may not cut off; the error is raised there"
DEVICE = "a task of a session, kept in one attribute, which the driver ends and starts anew"
TOOL = "a bench of a check or a campaign: awaited in the same function"

# May only shrink: the figure of each file, or folder, is exact.
ALLOWED: dict[str, tuple[int, str]] = {
    "orchestrator/clock/owner.py": (3, CLOCK),
    "orchestrator/clock/executor.py": (1, LOCAL),
    "orchestrator/clock/virtual.py": (3, CLOCK),
    "orchestrator/bus/answers.py": (1, "a repeated request gets the same result, or the same error"),
    "orchestrator/bus/memory/requests.py": (1, "runs in the context of the virtual process that answers"),
    "orchestrator/coordinator/jobs/queue/scheduler.py": (1, "an owned task waits for the job, and records its end"),
    "orchestrator/coordinator/motion/ahead.py": (1, RESULT),
    "orchestrator/coordinator/steps/home.py": (2, LOCAL),
    "orchestrator/coordinator/steps/search_requests.py": (1, LOCAL),
    "orchestrator/client/fleet.py": (3, LOCAL),
    "orchestrator/client/manual.py": (1, RESULT),
    "orchestrator/client/steps.py": (1, UNCUT),
    "orchestrator/gateway/stream/acts.py": (1, UNCUT),
    "orchestrator/cli/manual/jog/work_runner.py": (2, UNCUT),
    "orchestrator/cli/jobs/foreground.py": (4, LOCAL),
    "orchestrator/cli/machine/up.py": (2, LOCAL),
    "orchestrator/cli/estop/arm.py": (1, LOCAL),
    "orchestrator/cli/sim/serve.py": (2, LOCAL),
    "orchestrator/cli/demo.py": (1, LOCAL),
    "orchestrator/cli/keys/router.py": (1, LOCAL),
    "orchestrator/campaign/": (3, TOOL),
    "orchestrator/testing/": (1, TOOL),
    "orchestrator/conformance/": (3, TOOL),
    "orchestrator/bench/": (1, TOOL),
    "sim/link/process.py": (1, LOCAL),
    "integrations/bluesky/connection.py": (1, RESULT),
    "integrations/bluesky/flyer.py": (1, RESULT),
    "integrations/bluesky/moves.py": (1, RESULT),
    "adapters/toolkit/": (6, DEVICE),
    "adapters/cia402/": (5, DEVICE),
    "adapters/ppsmc/": (2, DEVICE),
    "adapters/shrc203/": (1, DEVICE),
    "adapters/smc30/": (2, DEVICE),
    "adapters/yaskawa/": (3, DEVICE),
}


def find_entry(path: str) -> str:
    """The entry of the list that a file belongs to; its own path if there is none."""
    return next((entry for entry in ALLOWED if path == entry or (entry[-1] == "/" and path.startswith(entry))), path)


def test_tasks_are_started_by_their_owners() -> None:
    found: Counter[str] = Counter()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            count = len(START.findall(path.read_text(encoding="utf-8")))
            if count:
                found[find_entry(path.relative_to(ROOT).as_posix())] += count
    allowed = {entry: count for entry, (count, _) in ALLOWED.items()}
    more = {entry: count for entry, count in found.items() if count > allowed.get(entry, 0)}
    assert not more, f"start these with `TaskOwner.spawn` or `running`: {more}"
    fewer = {entry: found[entry] for entry, count in allowed.items() if found[entry] < count}
    assert not fewer, f"the list shrinks; correct its figures: {fewer}"
