"""The SMC-4000: up to four axes, TCP, UDP and serial (L24-L55, L1719)."""

from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel

from orchestrator.clock.base import Clock
from orchestrator.model.fleet import Controller
from sim.core.controller import FirmwareTiming
from sim.core.oscillator import Oscillator
from sim.yaskawa.base import errors
from sim.yaskawa.base.campaign import ON_ETHERNET
from sim.yaskawa.base.data import MemoryCapacity
from sim.yaskawa.base.formats import NumberFormat
from sim.yaskawa.base.options import Smc4000Options
from sim.yaskawa.base.timebase import ServoTimebase
from sim.yaskawa.commands.dialect import COMMANDS, OPERANDS
from sim.yaskawa.language import parameters
from sim.yaskawa.language.expressions import FUNCTIONS
from sim.yaskawa.language.properties import BurnTimes
from sim.yaskawa.machine.commissioning import make_options
from sim.yaskawa.machine.controller import YaskawaBench, YaskawaController
from sim.yaskawa.machine.core import ControllerCore
from sim.yaskawa.machine.model import ControllerModel
from sim.yaskawa.motion.figures import MotionFigures

LOCK_ALL = 2
"""Level of LC at which only LC itself is accepted (L6735); TC still reports why (L6798)."""


_ABSENT = frozenset(("AF", "GN", "ZR"))
"""Op-codes of the family that its manual has no page of, though examples name them (L1229, L12527)."""


def _is_locked(level: int, op: str, lock: str, text: str) -> bool:
    return str(level) in lock or (level == LOCK_ALL and op not in ("LC", "TC"))


MODEL = ControllerModel(
    name="smc4000",
    revision="SMC4040 Rev 1.0a",
    ports=("tcp", "udp", "serial"),
    commands={op: command for op, command in COMMANDS.items() if op not in _ABSENT},
    operands={op: operand for op, operand in OPERANDS.items() if op not in _ABSENT},
    parameters=parameters.SMC4000,
    functions=frozenset(FUNCTIONS),
    texts=errors.SMC4000,
    letters="XYZW",
    figures=MotionFigures(
        fastest=(12_000_000, 8_000_000),
        vector=(25000, 256000, 256000),
        home_speed=512,
        encoder_resolution=16_777_216,
        default_plane=True,
        cam_points=1025,
        virtual_axis=True,
        systems="ST",
    ),
    room=MemoryCapacity(lines=2000, labels=510, variables=510, elements=15000, zero_frees=True),
    threads=8,
    time_bases=lambda axes: (250, 20000, 125),
    burning=BurnTimes({"BN": 1, "BP": 3, "BV": 1}, at_rest=frozenset(("BP", "BV")), cam=True),
    locks=_is_locked,
    lock_levels=3,
    formats={
        "CM": NumberFormat(1, 0),
        "LC": NumberFormat(1, 0),
        "PF": NumberFormat(2, 1),
        "VF": NumberFormat(2, 1),
        "VA": None,
        "VD": None,
        "VT": NumberFormat(1, 4),
    },
    handles="ABCDEFGH",
    comments=("'", "NO "),
    designators=True,
    external_clock=True,
    proper_arrays=True,
    password_discards=True,
    still_encoders=True,
    unasked=frozenset(("EM", "RL", "SC", "TD", "TE")),
    codes={114: 1, 115: 7, 117: 4},
    burned=frozenset(
        "AC BL CE DC DV EM ER FA FL GR IL IT KD KI KP MT NB NF NZ OE OF SP TL".split()  # noqa: SIM905
    ),
)

WITHOUT_DELAYS = {"input_fall_us": 0, "input_rise_us": 0, "latch_us": 0, "output_on_us": 0, "output_off_us": 0}
"""Options of a controller whose inputs and outputs act at once."""


class SmcSimulator:
    """Builds simulated controllers of one family; implements `Simulator`.

    options: the model of their options. find_model: the model for options. more_options: further options with which a
    controller fits a controller's part of a fleet file.
    """

    def __init__(
        self,
        name: str,
        options: type[Smc4000Options] = Smc4000Options,
        find_model: Callable[[Smc4000Options], ControllerModel] = lambda _: MODEL,
        more_options: Callable[[Controller], Mapping[str, Any]] = lambda _: {},
    ) -> None:
        self._name = name
        self._options = options
        self._find_model = find_model
        self._more_options = more_options

    campaign = ON_ETHERNET
    needs_exact_time = True  # on Ethernet

    @property
    def model(self) -> str:
        return self._name

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> YaskawaController:
        """Build a powered-up controller. Options are the fields of the options' model; `ValueError` names a wrong
        one."""
        chosen_options = self._options.model_validate(dict(options))
        model = self._find_model(chosen_options)
        timebase = ServoTimebase(clock, oscillator or Oscillator())
        machine = ControllerCore(timebase, model, chosen_options, timing or FirmwareTiming(), seed)
        usual = (chosen_options.link, *(port for port in model.ports if port != chosen_options.link))
        machine.ports.first_handle = chosen_options.handle or ""
        machine.ports.strict_packets = chosen_options.strict_packets
        machine.run_ready()
        return YaskawaController(machine, usual)

    @property
    def options_model(self) -> type[BaseModel]:
        return self._options

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file."""
        del expected
        return {**make_options(config, (2, 4)), **self._more_options(config)}

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> YaskawaBench:
        """Build the same controller, ideal in time, with the handles that test vectors need."""
        return YaskawaBench(self.build_controller(clock, WITHOUT_DELAYS | dict(options)))


SMC4000 = SmcSimulator("smc4000")
