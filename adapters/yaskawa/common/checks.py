"""Checks of a controller's part of the fleet file that both models share. All raise `ValueError`."""

from collections.abc import Collection, Mapping
from typing import TypeVar

from pydantic import ValidationError

from adapters.yaskawa.common import homing
from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.model.fleet import Controller

_Options = TypeVar("_Options", bound=YaskawaOptions)


def check_points(config: Controller, inputs: int, outputs: int) -> None:
    """Check the numbers of inputs and outputs; `inputs` and `outputs` are the largest ones."""
    for kind, points, most in (("inputs", config.inputs, inputs), ("outputs", config.outputs, outputs)):
        for name, point in points.items():
            if point.number > most:
                raise ValueError(f"{kind}.{name}.number: {point.number}; the controller has {kind} 1 to {most}")


def check_homing(config: Controller) -> None:
    """Check the methods of the reference searches."""
    for name, axis in config.axes.items():
        if axis.homing.method not in homing.METHODS:
            raise ValueError(
                f"axes.{name}.homing.method: {axis.homing.method!r}; this make has {', '.join(homing.METHODS)}"
            )


def check_options(config: Controller, model: type[_Options], motors: Mapping[str, int] | Collection[str]) -> _Options:
    """Return the validated options; `motors` are the axes of the controller."""
    try:
        options = model.model_validate(config.options)
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(f"options.{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    unknown = [name for name in options.motor_type if name not in motors]
    if unknown:
        raise ValueError(f"options.motor_type: no axis {unknown[0]}; axes are {', '.join(motors)}")
    return options
