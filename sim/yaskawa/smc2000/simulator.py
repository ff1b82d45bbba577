"""The SMC-2000: one to eight axes, two serial ports, daisy chain (L5-L63, L829-L995)."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from orchestrator.clock.base import Clock
from orchestrator.model.fleet import Controller
from sim.core.controller import DeviceSpec, FirmwareTiming, SimulatedController, VectorBench
from sim.core.oscillator import Oscillator
from sim.yaskawa.base import errors
from sim.yaskawa.base.campaign import IN_A_CHAIN
from sim.yaskawa.base.data import MemoryCapacity
from sim.yaskawa.base.formats import NumberFormat
from sim.yaskawa.base.options import HOP_NS, ChainOptions, Smc2000Options
from sim.yaskawa.base.timebase import ServoTimebase
from sim.yaskawa.commands.dialect import COMMANDS, OPERANDS
from sim.yaskawa.language.expressions import FUNCTIONS
from sim.yaskawa.language.properties import BurnTimes
from sim.yaskawa.language.registry import SMC2000_COMMANDS, SMC2000_OPERANDS
from sim.yaskawa.language.smc2000_parameters import SMC2000 as PARAMETERS
from sim.yaskawa.machine.commissioning import make_options
from sim.yaskawa.machine.controller import YaskawaBench, YaskawaController
from sim.yaskawa.machine.core import ControllerCore
from sim.yaskawa.machine.model import ControllerModel
from sim.yaskawa.motion.figures import MotionFigures
from sim.yaskawa.ports.serial_ports import CommandPort, GeneralPort
from sim.yaskawa.smc2000 import cam as smc2000_cam
from sim.yaskawa.smc2000 import motion as smc2000_motion
from sim.yaskawa.smc2000 import operands as smc2000_operands
from sim.yaskawa.smc2000 import points as smc2000_points
from sim.yaskawa.smc2000 import program as smc2000_program
from sim.yaskawa.smc2000 import serial as smc2000_serial
from sim.yaskawa.smc2000.chain import ChainBench, DaisyChain

OWN_MODULES = (
    smc2000_cam,
    smc2000_motion,
    smc2000_operands,
    smc2000_points,
    smc2000_program,
    smc2000_serial,
)
DECODE_NS = 500_000
"""The firmware's time for a command (L1000); the value of `FirmwareTiming.decode_ns` on real hardware."""
EXTERNAL = -1
"""`TM` of a controller that takes its samples from the wire (L976)."""
LOCK_SETTING = 2
"""Level of LC at which a port may only query and stop (L9879)."""

_SHARED = frozenset(
    """
    AB AC AE AF AI AM AP AR AS AT AV BG BL BN BP BV CB CD CE CM CR CS DA DC DE DL DM DP DT DV EB EM EO EP ER ES ET FA
    FE FI FL FV GN GR HM HX IL IT JG JP JS KD KI KP KS LC LE LI LM LS LT LV LZ MF MG MO MR MT NO OB OE OF PW QD QY RA RC
    PF RD RE RI RL RP SB SC SH SP ST TD TL TM TP TR TS TV TW TY UL VA VD VE VF VP VR VS VT WC WT XQ ZR ZS
    """.split()  # noqa: SIM905
)
_SHARED_OPERANDS = frozenset(
    """
    AB AC AE AF AL AV BG BL BN CE CM CS CW DA DC DE DL DM DP DT DV EB ED EG EM EO EP EQ ER FA FL FV GN GR HM HX IL IT JG
    KD KI KP KS LC LE LF LM LR LT LZ MO MT OE OF PF PR RC RD RL RP SC SH SP TB TC TD TE TL TM TN TP TS TT TV TW TY UL
    VA VD VE VF VP VR VS VT XQ ZR ZS
    """.split()  # noqa: SIM905
)
_ASKING = frozenset(
    "AB HX LA LC LL LV MG NO QU RL RP SC ST TB TC TD TE TI TP TS TT TV TY".split()  # noqa: SIM905
)
_LEAST_PERIOD = {1: 250, 2: 375, 4: 500, 8: 875}
"""Shortest period by the number of axes, microseconds (L13934)."""


def _is_locked(level: int, op: str, lock: str, text: str) -> bool:
    if "1" in lock:
        return True
    return level == LOCK_SETTING and op not in _ASKING and not text.endswith(("?", "="))


MODEL = ControllerModel(
    name="smc2000",
    revision="SMC-2000-{options.axes} Rev {options.firmware}",
    ports=("serial", "serial2"),
    commands={op: COMMANDS[op] for op in _SHARED} | SMC2000_COMMANDS,
    operands={op: OPERANDS[op] for op in _SHARED_OPERANDS} | SMC2000_OPERANDS,
    parameters=PARAMETERS,
    functions=frozenset(FUNCTIONS) - {"@ATAN", "@TAN"},
    texts=errors.SMC2000,
    letters="XYZWEFGH",
    figures=MotionFigures(
        fastest=(8_000_000, 8_000_000),
        vector=(8192, 262144, 262144),
        home_speed=256,
        cam_points=257,
        contour_step=32762,
        contour_stops_at_record=True,
        lag=0,
        cycles_by_turns=True,
        stepper_home_stages=2,
        stepper_fastest=2_000_000,
        default_plane=True,
    ),
    room=MemoryCapacity(lines=1000, labels=254, variables=254, elements=8000, zero_frees=True),
    threads=4,
    time_bases=lambda axes: (_LEAST_PERIOD[axes], 20000, 125),
    burning=BurnTimes({"BN": 1, "BP": 10, "BV": 2}, at_rest=frozenset(("BN", "BP"))),
    locks=_is_locked,
    lock_levels=2,
    password="00000000",
    serial_port=CommandPort,
    second_port=GeneralPort,
    by_trigger_line=False,
    spaced_names=False,
    comment_end=";",
    running_bit=6,
    still_data=False,
    switch_levels=False,
    speed_digits=7,
    keywords=("P1CD", "P1CH", "P1NM", "P1ST", "P2CD", "P2CH", "P2NM", "P2ST"),
    burned=frozenset(
        "AC AF BL CE DC DV EM ER FA FL FV GR IL IT KD KI KP MT OE OF SP TL".split()  # noqa: SIM905
    ),
    formats={
        "CM": NumberFormat(1, 0),
        "LC": NumberFormat(8, 0),
        "PF": NumberFormat(2, 1),
        "VF": NumberFormat(2, 1),
        "VA": None,
        "VD": None,
        "VS": None,
        "VT": NumberFormat(1, 4),
    },
    factory_echo=True,
    external_clock=True,
    codes={33: 4, 63: 1, 126: 6, 130: 1},
)


class Smc2000Simulator:
    """Builds simulated SMC-2000 controllers, alone or in a daisy chain; implements `Simulator`."""

    campaign = IN_A_CHAIN

    @property
    def model(self) -> str:
        return MODEL.name

    def build_controller(
        self,
        clock: Clock,
        options: Mapping[str, object],
        *,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> SimulatedController:
        """Build a powered-up controller. Options are the fields of `Smc2000Options`, or of `ChainOptions` when
        `chain` is among them; `ValueError` names a wrong one.
        """
        if "chain" in options:
            return self.build_chain(clock, options, oscillator, timing, seed)
        return self.build_single(clock, options, oscillator, timing, seed)

    @property
    def options_model(self) -> type[BaseModel]:
        return Smc2000Options

    def make_options(self, config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
        """The options with which it fits a controller's part of a fleet file."""
        del expected
        return make_options(config, (1, 2, 4, 8))

    def vector_bench(self, clock: Clock, options: Mapping[str, object]) -> VectorBench:
        """Build the same controller, ideal in time, with the handles that test vectors need."""
        if "chain" in options:
            return ChainBench(self.build_chain(clock, {"hop_ns": 0} | dict(options)))
        return YaskawaBench(self.build_single(clock, options))

    def build_shared(
        self, clock: Clock, devices: Sequence[DeviceSpec]
    ) -> tuple[DaisyChain, Sequence[YaskawaController]]:
        """Build a daisy chain, its controllers in their order from the host; port 2 of each is set up for it."""
        built_controllers = [
            self.build_single(
                clock,
                dict(unit.options) | {"address": unit.address, "chained": True},
                unit.oscillator,
                unit.timing,
                unit.seed,
            )
            for unit in devices
        ]
        return DaisyChain(clock, built_controllers, HOP_NS), built_controllers

    @staticmethod
    def build_single(
        clock: Clock,
        options: Mapping[str, object],
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> YaskawaController:
        """Build one controller."""
        chosen_options = Smc2000Options.model_validate(dict(options))
        timebase = ServoTimebase(clock, oscillator or Oscillator())
        machine = ControllerCore(timebase, MODEL, chosen_options, timing or FirmwareTiming(), seed)
        machine.run_ready()
        return YaskawaController(machine, MODEL.ports)

    def build_chain(
        self,
        clock: Clock,
        options: Mapping[str, object],
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> DaisyChain:
        """Build a daisy chain; each controller has a crystal of its own, all of the kind of `oscillator`."""
        chosen_options = ChainOptions.model_validate(dict(options))
        crystal = oscillator or Oscillator()
        units: list[YaskawaController] = []
        for number, unit in enumerate(chosen_options.chain):
            own = chosen_options.options | {
                "axes": unit.axes,
                "address": unit.address,
                "echo": chosen_options.echo,
                "chained": True,
            }
            drift_ppm = crystal.drift_ppm if unit.drift_ppm is None else unit.drift_ppm
            other_oscillator = Oscillator(crystal.offset_ns, drift_ppm, crystal.wander_ppm, crystal.seed + number)
            units.append(self.build_single(clock, own, other_oscillator, timing, seed + number))
        chain = DaisyChain(clock, units, chosen_options.hop_ns)
        if chosen_options.shared_clock:
            chain.share_clock()
        for unit, controller in zip(chosen_options.chain, units, strict=True):
            if unit.external_clock:
                controller.machine.memory.burn_period(EXTERNAL)
        return chain


SMC2000 = Smc2000Simulator()
