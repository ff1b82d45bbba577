"""Programs of packages of the system, which not every computer has."""

import os
import shutil

import pytest


def require_program(name: str) -> str:
    """The path of a program; without it the test is skipped, as `conftest` lets it be."""
    path = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if path is None:
        pytest.skip(f"the system's package {name} is not installed")
    return path
