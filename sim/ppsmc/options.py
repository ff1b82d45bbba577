"""Options of one SMC: its construction and wiring, and the choices that the manual leaves open.

"Decision n" numbers the open questions of the protocol reference.
"""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveInt, model_validator

Hardware = Literal["io_port", "counter", "filter", "half_screen", "eib7", "fbwf", "full_step", "pc_board"]
AxisKey = Annotated[str, Field(pattern=r"^(?:[1-9]|1[0-6])$")]
Zone = tuple[int, int]


class PpsmcOptions(BaseModel):
    """Options of one simulated SMC. Unknown ones are refused.

    The first group describes the controller and its stages (mechanical positions are motor steps from the position
    at the first power-up); the second chooses between readings of the manual.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    axes: Annotated[int, Field(ge=1, le=16)] = 1
    """Number of installed axes."""
    encoder: bool = False
    """Every axis has an incremental encoder input."""
    encoder_follows: bool = False
    """The encoders are coupled to the motors; otherwise they keep the loaded value."""
    increments_per_step: Annotated[float, Field(gt=0)] = 1.0
    """Encoder increments per motor step with signal multiplication 1."""
    gears: dict[AxisKey, tuple[PositiveInt, PositiveInt]] = {}
    """Stored `gnum` and `gden` of axes: steps per unit of distance (L871)."""
    hardware: list[Hardware] = []
    """Installed options; commands of others are ignored (decision 20)."""
    link: Literal["tcp", "serial"] = "tcp"
    """The interface that test vectors use."""
    travel_steps: dict[AxisKey, Zone] = {}
    """EL- is active at and below the first, EL+ at and above the second mechanical position."""
    org_steps: dict[AxisKey, Zone] = {}
    """The ORG switch is on between these mechanical positions."""
    sd_steps: dict[AxisKey, Zone] = {}
    """The SD switch is on between these mechanical positions."""
    index_steps: dict[AxisKey, Zone] = {}
    """The encoder index is high between these mechanical positions."""
    full_step_steps: Annotated[int, Field(ge=1)] = 10
    """Motor steps from one full-step position to the next."""
    counter_hz: Annotated[float, Field(ge=0)] = 0.0
    """Pulses per second at the counter input."""
    com_replies: dict[str, str] = {}
    """Replies of the device on the control COM port, by received string."""
    max_clients: Annotated[int, Field(ge=1)] = 16
    """TCP connections at a time."""

    firmware: Literal["1.1.165", "1.2"] = "1.1.165"
    """Decision 0: "1.2" answers as later firmware does."""
    greeting: bool = True
    """Decision 1: the version is sent on TCP connection."""
    txdel: Annotated[int, Field(ge=0, le=3)] = 3
    """Decision 2: delimiter after power-up."""
    echo: Annotated[int, Field(ge=0, le=2)] = 0
    """Decision 4: message level after power-up."""
    dcpl: Annotated[int, Field(ge=1, le=8)] = 4
    """Decision 6: decimals after power-up."""
    trailing_zeros: bool = False
    """Decision 6: positions are printed with all their decimals."""
    long_status: bool | None = None
    """Decision 7: ?status has the 17 fields of later firmware; None: as the firmware."""
    keep_target_buffer: bool = True
    """Decision 11: the target buffer survives tbg."""
    start_skew_us: Annotated[float, Field(ge=0, le=1000)] = 10.0
    """Decision 12: the axes of one group start within this."""
    queue_target: bool = True
    """Decision 13: one goto or move for a moving axis waits for the end of its motion; otherwise it is refused."""
    limit_clears_reference: bool = True
    """Decision 15: a limit stop makes the position invalid."""
    in_poll_ms: Annotated[float, Field(ge=0, le=1000)] = 10.0
    """Decision 18: period in which a waiting program polls the input port."""
    line_gap_ms: Annotated[float, Field(ge=0, le=1000)] = 1.0
    """Decision 18: from the end of one program line to the start of the next."""
    fmax_hz: Annotated[int, Field(ge=1)] = 100_000
    """Decision 22."""
    reset_s: Annotated[float, Field(ge=0, le=60)] = 1.0
    """The controller ignores input this long after reset; connections stay."""
    restart_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    """Decision 26: no connection this long after reboot and restart."""
    sleep_while_moving: bool = False
    """Decision 28: sleep is accepted during motion too."""
    line_limit: Annotated[int, Field(ge=16)] = 256
    """Longer command lines are refused, characters."""
    msg_comma: Annotated[str, Field(max_length=1)] = "!"
    """The character that msg sends for a comma (L3656)."""

    @model_validator(mode="after")
    def _check_consistency(self) -> "PpsmcOptions":
        for name in ("travel_steps", "org_steps", "sd_steps", "index_steps"):
            zones: dict[str, Zone] = getattr(self, name)
            for axis, (low, high) in zones.items():
                if int(axis) > self.axes:
                    raise ValueError(f"{name}: no axis {axis}; there are 1 to {self.axes}")
                if low > high:
                    raise ValueError(f"{name}: axis {axis}: the first position must not lie above the second")
        return self


def read_options(options: Mapping[str, object]) -> PpsmcOptions:
    """Validate the options. `ValueError` states the error and, for an unknown name, the allowed ones."""
    unknown = sorted(set(options) - set(PpsmcOptions.model_fields))
    if unknown:
        raise ValueError(
            f"unknown option {', '.join(unknown)}; allowed: {', '.join(sorted(PpsmcOptions.model_fields))}"
        )
    return PpsmcOptions.model_validate(dict(options))
