"""The settings of simulated controllers, from a fleet file and the defaults of its adapters."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from adapters.contract import validate_options
from adapters.host.makes import find_make_or_substitute
from orchestrator.clock.base import NS_PER_US
from orchestrator.model.explain import list_problems
from orchestrator.model.fleet import Controller
from orchestrator.model.problems import Problem
from sim.core.vectors import find_simulator

DECODE_US = 500  # of a firmware of which nothing is stated


def make_simulator_options(config: Controller) -> Mapping[str, Any]:
    """The options of the simulator for a controller that has passed its make's check: set up like the machine that
    the file describes. What `simulate.options` states has precedence."""
    options = validate_options(find_make_or_substitute(config.adapter).options_model, config)
    defaults = {name: getattr(options, name) for name in type(options).model_fields}
    derived_options = find_simulator(config.adapter).make_options(config, defaults)
    return {**derived_options, **config.simulate.options}


class SimulatedTiming(NamedTuple):
    """The time that a simulated firmware takes for a command, and a random extra time, ns."""

    decode_ns: int
    spread_ns: int


def find_timing(config: Controller) -> SimulatedTiming:
    """The timing of the simulated firmware: that of the fleet file, or else one that the adapter expects."""
    simulate = config.simulate
    if simulate.decode_us is not None:
        return SimulatedTiming(simulate.decode_us * NS_PER_US, simulate.spread_us * NS_PER_US)
    least_us, most_us = _find_decoding_us(
        validate_options(find_make_or_substitute(config.adapter).options_model, config)
    )
    if least_us <= DECODE_US <= most_us:
        return SimulatedTiming(DECODE_US * NS_PER_US, simulate.spread_us * NS_PER_US)
    return SimulatedTiming(least_us * NS_PER_US, (most_us - least_us) * NS_PER_US)


def _find_decoding_us(options: BaseModel) -> tuple[int, int]:
    """The shortest and longest time of a command by the options of an adapter, as far as it has such options."""
    usual_us: int = getattr(options, "decode_us", DECODE_US)
    spread_us: int | None = getattr(options, "decode_spread_us", None)
    if spread_us is not None:
        return max(0, usual_us - spread_us), usual_us + spread_us
    return min(getattr(options, "decode_min_us", 0), usual_us), usual_us


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
        return [Problem((*own, *problem.place), problem.text) for problem in list_problems(error, model)]
    return []
