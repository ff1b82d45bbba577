"""Every module of the product can be imported, on each Python that is tested."""

import importlib
import pkgutil
from collections.abc import Iterator

import pytest

import adapters
import orchestrator
import sim
import tutti

PACKAGES = (adapters, orchestrator, sim, tutti)
RUN_BY_NAME = ("__main__",)


def list_modules(package_names: tuple[str, ...]) -> Iterator[str]:
    for package in PACKAGES:
        if package.__name__ in package_names:
            for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
                if not module.name.endswith(RUN_BY_NAME):
                    yield module.name


@pytest.mark.parametrize("package", [package.__name__ for package in PACKAGES])
def test_every_module_can_be_imported(package: str) -> None:
    names = list(list_modules((package,)))
    assert len(names) > 5
    for name in names:
        importlib.import_module(name)
