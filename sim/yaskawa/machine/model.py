"""One complete model: its properties, its command tables, and the classes of its serial ports."""

from dataclasses import dataclass

from sim.yaskawa.language.model import LanguageModel
from sim.yaskawa.ports.ports import PortSession


@dataclass(frozen=True, eq=False, kw_only=True)
class ControllerModel(LanguageModel):
    """A model with the classes of its two serial ports."""

    serial_port: type[PortSession] = PortSession
    second_port: type[PortSession] = PortSession
