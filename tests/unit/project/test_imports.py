"""Every module can be imported, on each Python that is tested."""

import importlib
import pkgutil
from types import ModuleType

import pytest

import adapters
import benches
import orchestrator
import sim
import tutti

WINDOWS = {"orchestrator.cli.base.windows_console"}
"""`tests/live/test_without_unix.py` imports them."""


@pytest.mark.parametrize("package", [adapters, benches, orchestrator, sim, tutti], ids=lambda package: package.__name__)
def test_every_module_can_be_imported(package: ModuleType) -> None:
    names = [module.name for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")]
    assert len(names) > 5
    for name in set(names) - WINDOWS:
        importlib.import_module(name)
