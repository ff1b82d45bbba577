"""Checks of a controller's part of the fleet file that all models share: generators of what is wrong."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from adapters.yaskawa.common import homing
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.language.dialect import find_motor
from orchestrator.model.fleet import Controller


class Terminals(NamedTuple):
    """What a model has: the alphabets of its motors, the same as text, and the largest numbers of inputs, outputs."""

    names: Sequence[str]
    motors: str
    inputs: int
    outputs: int


def find_model_problems(config: Controller, terminals: Terminals, options: YaskawaOptions) -> Iterator[str]:
    """Everything that a controller of a model cannot have. options: those of the controller."""
    yield from _find_motor_problems(config, terminals)
    yield from _find_point_problems(config, terminals)
    yield from _find_homing_problems(config)
    yield from _find_option_problems(config, options)


def _find_motor_problems(config: Controller, terminals: Terminals) -> Iterator[str]:
    """Motors that the model does not have, and two names for one."""
    indices: dict[int, str] = {}
    for name, motor in ((name, motor) for name, axis in config.axes.items() for motor in axis.motors):
        index = find_motor(motor, terminals.names)
        if index is None:
            yield f"axes.{name}.motors: there is no motor {motor!r}; motors are {terminals.motors}"
        elif index in indices:
            of = "this axis" if indices[index] == name else "another axis"
            yield f"axes.{name}.motors: {motor} is another name for the motor of {of}"
        else:
            indices[index] = name


def _find_point_problems(config: Controller, terminals: Terminals) -> Iterator[str]:
    """Numbers of inputs and outputs that do not exist."""
    for kind, points, most in (
        ("inputs", config.inputs, terminals.inputs),
        ("outputs", config.outputs, terminals.outputs),
    ):
        for name, point in points.items():
            if point.number > most:
                yield f"{kind}.{name}.number: {point.number}; the controller has {kind} 1 to {most}"


def _find_homing_problems(config: Controller) -> Iterator[str]:
    """Methods of reference searches that this make does not have."""
    for name, axis in config.axes.items():
        if axis.homing.method not in homing.METHODS:
            yield f"axes.{name}.homing.method: {axis.homing.method!r}; this make has {', '.join(homing.METHODS)}"


def _find_option_problems(config: Controller, options: YaskawaOptions) -> Iterator[str]:
    """Options for axes that the controller does not have."""
    for name in options.motor_type:
        if name not in config.axes:
            yield f"options.motor_type.{name}: no axis {name}; axes are {', '.join(config.axes)}"
