"""Options of a simulated controller. Each open point of the manuals that hardware may decide otherwise is a switch.

`D…` are the decisions of section 16 in `docs/reference/controllers/smc4000.md`; those of `Smc2000Options` are in
section 10 of `docs/reference/controllers/smc2000.md`.
"""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

MAIN_BAUD = 19200
"""Default baud rate of port 1 of the SMC-2000 (L910)."""
HOP_NS = 520_833
"""D10: store and forward of a controller of a chain; one character at that rate."""
Microseconds = Annotated[int, Field(ge=0, le=100_000)]
_BYTE = 8
_ABSENT_OUTPUTS = frozenset((24, 32, 40, 48, 56, 64))


class FamilyOptions(BaseModel):
    """Options of every model. Positions are physical, in counts, 0 at power-up."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    echo: bool = True
    """Power-up state of `EO`."""
    address: int = 0
    """SMC-4000: IP address, as the signed 32-bit number of `_IA0`. SMC-2000: address in the daisy chain."""
    serial_number: int = Field(default=1, ge=1, le=65535)
    home_edge: dict[str, int] = Field(default_factory=dict[str, int])
    """Per axis: the home input is low below this position and high from it on."""
    index_every: dict[str, int] = Field(default_factory=dict[str, int])
    """Per axis: an index pulse at every multiple of this."""
    travel: dict[str, tuple[int, int]] = Field(default_factory=dict[str, tuple[int, int]])
    """Per axis: positions of the reverse and the forward limit switch."""
    names: dict[str, str] = Field(default_factory=dict[str, str])
    """Per axis: the other name (A for X) under which the record of true motions has it, that of the fleet file."""
    question_crlf: bool = False
    """D1: a refusal ends with CR LF."""
    control_end: Literal["optional", "separate", "required"] = "optional"
    """D33 (SMC-2000: D58): CR, CR LF or `;` after a control sequence such as ctrl-R ctrl-V. `optional`: it belongs to
    the sequence; `separate`: it is an empty command with a prompt of its own; `required`: the sequence takes effect
    with it."""
    upload_line_end: bool = False
    """D109 (SMC-2000: D59): CR LF between the control Z that ends UL and the prompt."""
    sign_column: bool = True
    """D2: a positive number has a blank in place of the sign."""
    late_contour_error: bool = False
    """D13: a late CD answers `?` and 42."""
    st_halts_programs: bool = True
    """D35: `ST` without letters from a port halts all threads."""
    av_absolute: bool = False
    """D74: AV counts from the start of the sequence."""
    zero_segments: bool = True
    """A segment without length is accepted and skipped; otherwise refused with 30 (SMC-2000: D25)."""
    input_fall_us: Microseconds = 0
    input_rise_us: Microseconds = 0
    """From a change at the terminal of a digital input, to low or to high, to the firmware."""
    latch_us: Microseconds = 0
    """From a falling input to the capture of a position; a shorter pulse is not seen."""
    output_on_us: Microseconds = 0
    output_off_us: Microseconds = 0
    """From the firmware to the terminal of a digital output."""
    burn_takes_time: bool = False
    """D56: BN, BP and BV take their documented times before they are answered."""

    @property
    def axis_count(self) -> int:
        """Number of real axes."""
        raise NotImplementedError

    @property
    def input_count(self) -> int:
        """Number of digital inputs."""
        return _BYTE

    @property
    def output_count(self) -> int:
        """Number of digital outputs."""
        return _BYTE

    @property
    def analog_count(self) -> int:
        """Number of analog inputs."""
        return 0

    @property
    def absent_outputs(self) -> frozenset[int]:
        """Outputs that have a number but no terminal."""
        return frozenset()

    @property
    def channel_count(self) -> int:
        """Number of arrays that RA can record into at once."""
        return 8

    @property
    def encoder_readings(self) -> Mapping[str, int]:
        """Readings of the absolute encoders, per axis, counts; empty without the option."""
        return {}

    @property
    def needs_address(self) -> bool:
        """Whether it ignores commands before it is addressed."""
        return False

    @property
    def second_line(self) -> tuple[int, int, int, int]:
        """`CC` after a master reset: baud rate, handshake, daisy chain, echo."""
        return 0, 0, 0, 0

    @property
    def can_step(self) -> bool:
        """Whether axes can drive stepper motors."""
        return True

    @property
    def own_modulus(self) -> bool:
        """Whether the cycle of a cam's master is set separately from those of the slaves, by MM."""
        return False

    @property
    def servo_on(self) -> bool:
        """Whether motors are on after a master reset."""
        return False

    @property
    def program_ns(self) -> int:
        """Time that a command of a program takes in addition to the requested firmware time, ns."""
        return 0


class Smc4000Options(FamilyOptions):
    """Options of the SMC-4000."""

    axes: Literal[2, 4] = 4
    input_fall_us: Microseconds = 500
    input_rise_us: Microseconds = 1500
    latch_us: Microseconds = 9
    output_on_us: Microseconds = 250
    output_off_us: Microseconds = 500
    """The largest times that the manual states (L407-L415, L482), and the shortest pulse at a latch."""
    link: Literal["tcp", "udp", "serial"] = "tcp"
    """The default port: the first of `ports`."""
    handle: Literal["A", "B", "C", "D", "E", "F", "G", "H"] | None = None
    """The Ethernet handle of the first connection."""
    absolute_encoders: dict[str, int] = Field(default_factory=dict[str, int])
    """Per axis: the reading of `AE`, counts; empty without the W option (L49)."""
    qr_axis_bytes: Literal[26, 28] = 26
    """D28: bytes of an axis block of `QR`."""
    strict_packets: bool = False
    """D39: the rest of a packet after its last terminator is dropped."""

    @property
    def axis_count(self) -> int:
        return self.axes

    @property
    def encoder_readings(self) -> Mapping[str, int]:
        return self.absolute_encoders


class ChainDevice(BaseModel):
    """One controller of a daisy chain."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: int = Field(ge=0, le=7)
    axes: Literal[1, 2, 4, 8] = 4
    drift_ppm: float | None = None
    """Drift of its crystal; None: that of the chain's oscillator."""
    external_clock: bool = False
    """`TM -1` is burned: it takes its samples over the wire of `shared_clock`."""


class Smc2000Options(FamilyOptions):
    """Options of the SMC-2000. Numbers of decisions are those of `docs/reference/controllers/smc2000.md`."""

    axes: Literal[1, 2, 4, 8] = 4
    address: int = Field(default=0, ge=0, le=7)
    chained: bool = False
    """Part of a daisy chain: accepts only `%A` and `!` before it is addressed, and forwards from power-up on."""
    extended_io: bool = False
    """Inputs 25 to 64 and outputs 17 to 63 (L13398)."""
    firmware: Literal["2.0g", "D150N19p"] = "2.0g"
    motors_on: bool = True
    """D35: servos are on after a master reset."""
    stepper_jumpers: bool = True
    """The jumpers that stepper motors need are installed (L794); without them `MT 2` is refused with 96."""
    absolute_encoders: dict[str, int] = Field(default_factory=dict[str, int])
    """Per axis: the reading of `AE`, counts; empty without the W option."""
    command_s: float = Field(default=0.0, ge=0.0)
    """D11: duration of a command of a program, seconds."""

    @property
    def axis_count(self) -> int:
        return self.axes

    @property
    def input_count(self) -> int:
        return 64 if self.extended_io else 24 if self.axes == 8 else _BYTE

    @property
    def output_count(self) -> int:
        return 64 if self.extended_io else 16 if self.axes == 8 else _BYTE

    @property
    def analog_count(self) -> int:
        return 7

    @property
    def absent_outputs(self) -> frozenset[int]:
        return _ABSENT_OUTPUTS if self.extended_io else frozenset()

    @property
    def channel_count(self) -> int:
        return 8 if self.axes == 8 else 4

    @property
    def encoder_readings(self) -> Mapping[str, int]:
        return self.absolute_encoders

    @property
    def needs_address(self) -> bool:
        return self.chained

    @property
    def second_line(self) -> tuple[int, int, int, int]:
        return (MAIN_BAUD, 0, 1, 0) if self.chained else super().second_line

    @property
    def can_step(self) -> bool:
        return self.stepper_jumpers

    @property
    def own_modulus(self) -> bool:
        return self.firmware == "D150N19p"

    @property
    def servo_on(self) -> bool:
        return self.motors_on

    @property
    def program_ns(self) -> int:
        return round(self.command_s * 1_000_000_000)


class ChainOptions(BaseModel):
    """Options of a daisy chain of SMC-2000 on one serial port; `chain` lists the controllers, the host's first."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    chain: list[ChainDevice] = Field(min_length=1, max_length=8)
    echo: bool = True
    """Power-up state of `EO` of all controllers."""
    hop_ns: int = Field(default=HOP_NS, ge=0)
    """D10: store and forward of each controller; one character at 19200 baud."""
    shared_clock: bool = False
    """The first controller's sample clock is wired to the others (L975)."""
    options: dict[str, object] = Field(default_factory=dict[str, object])
    """Further options of all controllers."""
