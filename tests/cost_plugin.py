"""A pytest plug-in that notes what each test costs, for `make test-cost`: processor and wall time, children included.

Each process of the suite appends to a file of its own in the folder that `TUTTI_TEST_COST` names. The time of a child
counts for the test in which it was waited for.
"""

import json
import os
import resource
import time
from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

import pytest

FOLDER = "TUTTI_TEST_COST"


class Reading(NamedTuple):
    """cpu_s: of this process. children_s: of children that were waited for. wall_s: on a clock that never steps."""

    cpu_s: float
    children_s: float
    wall_s: float


def read_clocks() -> Reading:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Reading(time.process_time(), children.ru_utime + children.ru_stime, time.perf_counter())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    before = read_clocks()
    try:
        return (yield)
    finally:
        cost = Reading(*(end - begin for begin, end in zip(before, read_clocks(), strict=True)))
        line = json.dumps({"test": item.nodeid, **cost._asdict()})
        with (Path(os.environ[FOLDER]) / f"{os.getpid()}.jsonl").open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")
