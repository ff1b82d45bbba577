"""Checks of the form of a driver: its methods take the parameters that the contract names."""

import inspect
from collections.abc import Sequence
from functools import partial

from adapters.abilities import ABILITIES
from adapters.contract import Driver
from orchestrator.conformance.findings import require
from orchestrator.conformance.worlds import Case, World, run_case


def find_wrong_signatures(driver: type[Driver], contract: Sequence[type] = (Driver, *ABILITIES)) -> list[str]:
    """Return what is wrong with the parameters of each method of a driver's class, which callers of the contract could
    not call."""
    found: list[str] = []
    methods = [each for offered in contract for each in vars(offered).items()]
    for name, member in methods:
        if name.startswith("_") or not inspect.isfunction(member) or not hasattr(driver, name):
            continue
        own = inspect.signature(getattr(driver, name)).parameters
        takes_any = any(each.kind is inspect.Parameter.VAR_KEYWORD for each in own.values())
        for parameter in inspect.signature(member).parameters.values():
            given = own.get(parameter.name)
            if given is None and not takes_any:
                found.append(f"{name} has no parameter {parameter.name}")
            elif given is not None and given.default is given.empty and parameter.default is not parameter.empty:
                found.append(f"{name} requires {parameter.name}, which callers may leave out")
    return found


def check_signatures(case: Case) -> None:
    """Check the driver of a case. Raises `ContractBroken`."""
    found: list[str] = []

    async def look(world: World, wrong: list[str]) -> None:
        for unit in world.units:
            wrong += find_wrong_signatures(type(unit.driver))

    run_case(case, partial(look, wrong=found))
    require(not found, "; ".join(found))
