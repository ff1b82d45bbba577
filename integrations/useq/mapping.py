"""What stands in a fleet for the parts of a microscope."""

from dataclasses import dataclass, field

from tutti import TuttiError

COORDINATES = ("x", "y", "z")
CAMERA = "camera"
CHANNEL = "channel."


class BadMapping(TuttiError, ValueError):
    """An entry of a mapping that cannot be used. remedy: what to write."""

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(text)
        self.text = text
        self.remedy = remedy


@dataclass(frozen=True, slots=True)
class MicroscopeMap:
    """axes: `controller.axis` by coordinate. camera: the output that triggers it, None: there is none. channels: the
    output that is on during each channel, by its name. ignored: parts of a sequence that nothing stands for, on
    purpose: `x`, `y`, `z`, `camera`, `autofocus`, `time`, `shutter`, `channel.NAME`, or what else a message names."""

    axes: dict[str, str] = field(default_factory=dict[str, str])
    camera: str | None = None
    channels: dict[str, str] = field(default_factory=dict[str, str])
    ignored: frozenset[str] = frozenset()


def read_mapping(entries: list[str], ignored: list[str]) -> MicroscopeMap:
    """Read `x=gantry.x,y=gantry.y,camera=gantry.lamp,channel.DAPI=gantry.laser`. Raises `BadMapping`."""
    targets: dict[str, str] = {}
    for entry in split_words(entries):
        name, target = _read_entry(entry)
        if name in targets:
            raise BadMapping(f"{entry}: {name} is in the mapping already", "remove one of both")
        targets[name] = target
    axes = {name: target for name, target in targets.items() if name in COORDINATES}
    if len(set(axes.values())) < len(axes):
        raise BadMapping(f"{', '.join(axes.values())}: one axis stands for two coordinates", "map each to its own")
    channels = {name.removeprefix(CHANNEL): target for name, target in targets.items() if name.startswith(CHANNEL)}
    return MicroscopeMap(axes, targets.get(CAMERA), channels, frozenset(split_words(ignored)))


def _read_entry(entry: str) -> tuple[str, str]:
    """The name and the target of one entry. Raises `BadMapping`."""
    name, _, target = (word.strip() for word in entry.partition("="))
    controller, _, part = target.partition(".")
    if not controller or not part:
        raise BadMapping(f"{entry}: this is no entry of a mapping", "write NAME=CONTROLLER.NAME, such as x=gantry.x")
    if name not in (*COORDINATES, CAMERA) and (not name.startswith(CHANNEL) or name == CHANNEL):
        raise BadMapping(f"{entry}: no sequence has {name!r}", "there are x, y, z, camera and channel.NAME")
    return name, target


def split_words(texts: list[str]) -> list[str]:
    """The parts of texts between commas."""
    return [part.strip() for text in texts for part in text.split(",") if part.strip()]
