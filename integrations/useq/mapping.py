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
    axes: dict[str, str] = {}
    channels: dict[str, str] = {}
    camera: str | None = None
    for entry in (part.strip() for text in entries for part in text.split(",") if part.strip()):
        name, sign, target = (word.strip() for word in entry.partition("="))
        if not sign or "." not in target.strip("."):
            raise BadMapping(
                f"{entry}: this is no entry of a mapping", "write NAME=CONTROLLER.NAME, such as x=gantry.x"
            )
        if name in axes or name.removeprefix(CHANNEL) in channels or (name == CAMERA and camera is not None):
            raise BadMapping(f"{entry}: {name} is in the mapping already", "remove one of both")
        if name in COORDINATES:
            axes[name] = target
        elif name == CAMERA:
            camera = target
        elif name.startswith(CHANNEL) and name != CHANNEL:
            channels[name.removeprefix(CHANNEL)] = target
        else:
            raise BadMapping(f"{entry}: no sequence has {name!r}", "there are x, y, z, camera and channel.NAME")
    shared_axes = [axis for axis in axes.values() if list(axes.values()).count(axis) > 1]
    if shared_axes:
        raise BadMapping(f"{shared_axes[0]} stands for two coordinates", "map each to an axis of its own")
    names = (part.strip() for text in ignored for part in text.split(","))
    return MicroscopeMap(axes, camera, channels, frozenset(name for name in names if name))
