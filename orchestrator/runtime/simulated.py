"""The settings of simulated controllers, from a fleet file and the defaults of its adapters."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from adapters.contract import validate_options
from adapters.host.host import find_make
from orchestrator.model.explain import list_problems
from orchestrator.model.fleet import Controller
from orchestrator.model.problems import Problem
from sim.core.vectors import find_simulator


def make_simulator_options(config: Controller) -> Mapping[str, Any]:
    """The options of the simulator for a controller that has passed its make's check: set up like the machine that
    the file describes. What `simulate.options` states has precedence."""
    options = validate_options(find_make(config.adapter).options_model, config)
    expected = {name: getattr(options, name) for name in type(options).model_fields}
    derived = find_simulator(config.adapter).make_options(config, expected)
    return {**derived, **config.simulate.options}


def find_simulation_problems(name: str, config: Controller) -> list[Problem]:
    """Mistakes in `simulate.options`. A make without a simulator has none."""
    try:
        model = find_simulator(config.adapter).options_model
    except ValueError:
        return []
    own = ("controllers", name, "simulate", "options")
    try:
        model.model_validate(dict(config.simulate.options))
    except ValidationError as error:
        return [Problem((*own, *each.place), each.text) for each in list_problems(error, model)]
    return []
