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
    problems: list[str] = []
    methods = [item for protocol in contract for item in vars(protocol).items()]
    for name, member in methods:
        if name.startswith("_") or not inspect.isfunction(member) or not hasattr(driver, name):
            continue
        own = inspect.signature(getattr(driver, name)).parameters
        takes_any = any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in own.values())
        for parameter in inspect.signature(member).parameters.values():
            own_parameter = own.get(parameter.name)
            if own_parameter is None and not takes_any:
                problems.append(f"{name} has no parameter {parameter.name}")
            elif (
                own_parameter is not None
                and own_parameter.default is own_parameter.empty
                and parameter.default is not parameter.empty
            ):
                problems.append(f"{name} requires {parameter.name}, which callers may leave out")
    return problems


def check_signatures(case: Case) -> None:
    """Check the driver of a case. Raises `ContractBroken`."""
    problems: list[str] = []

    async def look(world: World, wrong: list[str]) -> None:
        for unit in world.units:
            wrong += find_wrong_signatures(type(unit.driver))

    run_case(case, partial(look, wrong=problems))
    require(not problems, "; ".join(problems))
