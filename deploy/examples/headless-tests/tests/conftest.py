"""What the tests share: the fleet, homed; and the jobs."""

from pathlib import Path

import pytest

from tutti import Job, load_job

PROJECT = Path(__file__).parents[1]


def read_job(name: str) -> Job:
    return load_job(PROJECT / "jobs" / f"{name}.job.yaml")


@pytest.fixture
def load() -> Job:
    return read_job("load")


@pytest.fixture
def scan() -> Job:
    return read_job("scan")


@pytest.fixture
def park() -> Job:
    return read_job("park")


@pytest.fixture
def day(load: Job, scan: Job, park: Job) -> list[Job]:
    return [load, scan, load, scan, park]


@pytest.fixture
def fleet(virtual_fleet):
    """The fleet of this project in virtual time, with all axes on and homed."""
    fleet = virtual_fleet(PROJECT / "lab.fleet.yaml")
    fleet.tutti.enable("gantry", "stage")
    fleet.tutti.home()
    return fleet
