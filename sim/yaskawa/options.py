"""How a simulated SMC-4000 is built. Every open point of the manual that hardware may decide otherwise is a switch."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class Options(BaseModel):
    """Options of the SMC-4000. Places are physical positions in counts, 0 at power-up."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    axes: Literal[2, 4] = 4
    link: Literal["tcp", "udp", "serial"] = "tcp"
    """The port that is usual for this unit: the first of `ports`."""
    echo: bool = True
    """Power-up state of `EO`; has no effect on Ethernet (L4836)."""
    handle: Literal["A", "B", "C", "D", "E", "F", "G", "H"] | None = None
    """The Ethernet handle of the first connection."""
    address: int = 0
    """IP address, as the signed 32-bit number of `_IA0`."""
    serial_number: int = Field(default=1, ge=1, le=65535)
    home_edge: dict[str, int] = Field(default_factory=dict[str, int])
    """Per axis: the home input is low below this place and high from it on."""
    index_every: dict[str, int] = Field(default_factory=dict[str, int])
    """Per axis: an index pulse at every multiple of this."""
    travel: dict[str, tuple[int, int]] = Field(default_factory=dict[str, tuple[int, int]])
    """Per axis: places of the reverse and the forward limit switch."""
    question_crlf: bool = False
    """D1: a refusal ends with CR LF."""
    sign_column: bool = True
    """D2: a positive number has a blank where the sign would be."""
    late_contour_error: bool = False
    """D13: a late CD answers `?` and 42."""
    qr_axis_bytes: Literal[26, 28] = 26
    """D28: bytes of an axis block of `QR`."""
    st_halts_programs: bool = True
    """D35: `ST` without letters from a port halts all threads."""
    strict_packets: bool = False
    """D39: what a packet holds behind its last CR is dropped."""
    av_absolute: bool = False
    """D74: AV counts from the start of the sequence."""
    burn_takes_time: bool = False
    """D56: BN, BP and BV take 1, 3 and 1 s before they answer."""
