"""All axes of a fleet as devices, without a list by hand: for a start-up script, or a worker of queueserver."""

import re
from pathlib import Path

from integrations.bluesky.axis import TuttiAxis
from integrations.bluesky.connection import TuttiConnection
from tutti import load_fleet


def make_devices(fleet_file: Path | str, connection: TuttiConnection) -> dict[str, TuttiAxis]:
    """A device for each axis of a fleet file, by name: `gantry.x` is `gantry_x`. Raises `FileError`.

    In a start-up script: `with init_devices(): globals().update(make_devices("lab.fleet.yaml", lab))`.
    """
    fleet = load_fleet(Path(fleet_file))
    axes = (f"{controller}.{axis}" for controller, config in fleet.controllers.items() for axis in config.axes)
    return {name: TuttiAxis(connection, axis, name) for axis in axes for name in [make_name(axis)]}


def make_name(axis: str) -> str:
    """A name for a Python variable and for keys of documents, which have no dots."""
    return re.sub(r"\W", "_", axis)
