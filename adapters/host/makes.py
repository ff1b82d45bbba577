"""The installed makes: found by entry point, and what they say about the controllers of a fleet file."""

import re
from collections.abc import Mapping
from functools import cache
from typing import Any, cast

from adapters.contract import ConfigError, Make, validate_options
from adapters.host.unusable import UnusableMake
from adapters.toolkit.frames import FrameDecoder, TextDecoder
from orchestrator.model.fleet import Axis, Controller, Fleet, SerialLink
from orchestrator.model.plugins import PluginError, PluginListing, list_plugins, load_plugin, plugin_names
from orchestrator.model.problems import Problem
from orchestrator.model.units import find_dimension

# What a plug-in must have. A make of another project need not derive from `Make`.
_MEMBERS = (
    "name",
    "options_model",
    "check_config",
    "fleet_example",
    "serial_defaults",
    "create_driver",
    "stop_bytes",
)


@cache
def find_make(name: str) -> Make:
    """Return the make that the entry points of `tutti.adapters` provide for `name`.

    Raises `UnknownPlugin`, which lists the known ones, or `PluginError`; both are a `ValueError`.
    """
    return cast(Make, load_plugin("tutti.adapters", name, _MEMBERS))


def known_makes() -> list[str]:
    """Return the names of all makes that are installed."""
    return plugin_names("tutti.adapters")


def list_makes() -> list[PluginListing]:
    """Return all installed makes, with the reason where one cannot be used."""
    return list_plugins("tutti.adapters", _MEMBERS)


def find_make_or_substitute(name: str) -> Make:
    """Return the make, or for one whose plug-in is broken a substitute whose controllers never connect: the other
    controllers of the host are not affected. Raises `UnknownPlugin`."""
    try:
        return find_make(name)
    except PluginError as error:
        return UnusableMake(name, error)


def find_decoder(name: str, options: Mapping[str, Any]) -> FrameDecoder:
    """Return the decoder of a make for a controller with these options; one for text lines where it has none, or is not
    installed here."""
    try:
        maker = getattr(find_make(name), "make_decoder", None)
        return TextDecoder() if maker is None else cast(FrameDecoder, maker(options))
    except ValueError:
        return TextDecoder()


def apply_make_defaults(fleet: Fleet) -> Fleet:
    """Return the fleet with the serial settings that its file leaves to the makes, e.g. odd parity for an SMC30."""
    controllers: dict[str, Controller] = {}
    makes = known_makes()
    for name, config in fleet.controllers.items():
        controllers[name] = config
        if isinstance(config.link, SerialLink) and config.adapter in makes:
            given_fields = config.link.model_fields_set
            defaults = find_make_or_substitute(config.adapter).serial_defaults
            missing_values = {k: v for k, v in defaults.items() if k not in given_fields}
            if missing_values:
                controllers[name] = config.model_copy(update={"link": config.link.model_copy(update=missing_values)})
    return fleet.model_copy(update={"controllers": controllers})


def find_controller_problems(name: str, config: Controller, *, tolerant: bool = False) -> list[Problem]:
    """Return every mistake in a controller's part of the fleet file by the rules of its make, with its place.

    tolerant: a plug-in that is installed and cannot be used is no mistake of the file.
    """
    own: tuple[str, ...] = ("controllers", name)
    try:
        make = find_make_or_substitute(config.adapter) if tolerant else find_make(config.adapter)
    except ValueError as error:
        return [Problem((*own, "adapter"), str(error), config.adapter)]
    texts: list[str] = []
    try:
        validate_options(make.options_model, config)
    except ConfigError as error:
        texts += error.texts
        wrong = {text.split(":")[0].split(".")[1] for text in error.texts}
        # Without them, so that the rest of the controller is checked too.
        right_options = {name: value for name, value in config.options.items() if name not in wrong}
        config = config.model_copy(update={"options": right_options})
    try:
        make.check_config(config)
    except ConfigError as error:
        texts += error.texts
    except ValueError as error:  # of a make outside this project
        texts.append(str(error))
    texts += _explain_axes(make, config)
    return [_locate_problem(own, text) for text in dict.fromkeys(texts)]


def _explain_axes(make: Make, config: Controller) -> list[str]:
    """What is wrong with axes by what a make states of itself."""
    texts: list[str] = []
    if not getattr(make, "gears_motors", False):
        texts += [_explain_pair(name, config) for name, axis in config.axes.items() if axis.rack is not None]
    if getattr(make, "searches_by_direction", False):
        texts += [_explain_side(name, axis) for name, axis in config.axes.items() if _is_beyond_switch(axis)]
    return texts


def _explain_pair(name: str, config: Controller) -> str:
    first, second = config.axes[name].motors
    return (
        f"axes.{name}.motors: {config.adapter} cannot gear motor {second} to {first}; give each an axis of its own, "
        "and make a pair of these axes under `virtual`"
    )


def _is_beyond_switch(axis: Axis) -> bool:
    """Return whether all that the soft limits allow is on the far side of the home switch: the search ends at 0. A
    rotary axis may pass its switch."""
    limits = axis.soft_limits_counts
    if limits is None or axis.kind == "rotary" or find_dimension(axis.unit) == "angle" or axis.homing.method == "here":
        return False
    return limits[1] <= 0 if axis.homing_sign < 0 else limits[0] >= 0


def _explain_side(name: str, axis: Axis) -> str:
    limits, direction = axis.soft_limits, axis.homing.direction
    assert limits is not None
    reverse, side = ("positive", "above") if direction == "negative" else ("negative", "below")
    return (
        f"axes.{name}.soft_limits: {limits.min} to {limits.max} lies beyond the home switch: the search goes in "
        f"{direction} direction and ends at 0, with the travel {side} it. Correct the range, or state `homing: "
        f"{{direction: {reverse}}}`"
    )


_FIELD = re.compile(r"([a-z_][\w.-]*): ")


def _locate_problem(own: tuple[str, ...], text: str) -> Problem:
    """The place of a mistake whose text begins with its field."""
    field_match = _FIELD.match(text)
    return (
        Problem(own, text)
        if field_match is None
        else Problem((*own, *field_match[1].split(".")), text[field_match.end() :])
    )


def stops_by_line(controllers: Mapping[str, Controller]) -> list[tuple[list[str], bytes]]:
    """Return, for each line, the names of its controllers and the bytes that stop all of them: a line is opened
    once."""
    lines: dict[str, tuple[list[str], list[bytes]]] = {}
    for name, config in controllers.items():
        names, stops = lines.setdefault(config.link.endpoint, ([], []))
        names.append(name)
        stop = find_make_or_substitute(config.adapter).stop_bytes(config)
        # A stop that reaches all controllers of a line is sent once.
        if stop and stop not in stops:
            stops.append(stop)
    return [(names, b"".join(stops)) for names, stops in lines.values() if stops]
