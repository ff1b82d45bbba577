"""Command-line arguments of a simulator process, with validation."""

import argparse
import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from orchestrator.model.problems import describe_first_error

_LOOPBACK = ("localhost", "::1")

NEXT = "--next"
"""Separates the arguments of several links."""

M = TypeVar("M", bound=BaseModel)


class TimingFields(BaseModel):
    """`--timing`: processing time of the firmware, ns."""

    model_config = ConfigDict(extra="forbid")

    decode_ns: int = Field(default=0, ge=0)
    spread_ns: int = Field(default=0, ge=0)


class OscillatorFields(BaseModel):
    """`--oscillator`: the controller's own crystal."""

    model_config = ConfigDict(extra="forbid")

    offset_ns: int = 0
    drift_ppm: float = Field(default=0.0, ge=-1000, le=1000)
    wander_ppm: float = Field(default=0.0, ge=0, le=100)
    seed: int = 0


class WireFields(BaseModel):
    """A wire from an output of a simulated controller to an input of another: while the output is on, the input has
    `level_when_on`.

    world: the named pipe of the other controller's environment."""

    model_config = ConfigDict(extra="forbid")

    output: int = Field(ge=0)
    world: Path
    input: int = Field(ge=0)
    level_when_on: bool = True
    delay_us: int = Field(default=0, ge=0, le=100_000)


class DeviceFields(BaseModel):
    """`--unit`: one of several controllers that share the link.

    truth, world: as the arguments of these names."""

    model_config = ConfigDict(extra="forbid")

    name: str
    address: int | None = None
    options: dict[str, Any] = Field(default_factory=dict[str, Any])
    timing: TimingFields = TimingFields()
    oscillator: OscillatorFields = OscillatorFields()
    seed: int = 0
    truth: Path | None = None
    world: Path | None = None
    wires: list[WireFields] = Field(default_factory=list[WireFields])


@dataclass(frozen=True, slots=True)
class TcpAddress:
    """Listen at a TCP port of this host; port 0: a free one."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class UdpAddress:
    """Receive datagrams at a UDP port of this host; port 0: a free one."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class PtyAddress:
    """Serve a pseudo-terminal that this path points to."""

    link: Path


class SimulatorArgumentParser(argparse.ArgumentParser):
    """Argument parser that reports an error in one line and exits with code 2."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: {message}\n")
        raise SystemExit(2)


def parse_arguments(arguments: Sequence[str] | None) -> list[argparse.Namespace]:
    """Parse the arguments of each requested link. Exits with code 2 and one line on stderr when one is invalid."""
    links: list[list[str]] = [[]]
    for argument in sys.argv[1:] if arguments is None else arguments:
        if argument == NEXT:
            links.append([])
        else:
            links[-1].append(argument)
    parser = _build_parser()
    return [parser.parse_args(link) for link in links]


def _build_parser() -> argparse.ArgumentParser:
    parser = SimulatorArgumentParser(
        prog="python -m sim.link.process",
        description="Run one simulated controller on a real link.",
        epilog=f"{NEXT} separates the arguments of several links that one process serves.",
    )
    parser.add_argument("--model", required=True, help="a simulated model, e.g. smc4000")
    parser.add_argument("--name", required=True, help="the controller's name in the fleet file")
    parser.add_argument(
        "--listen",
        required=True,
        type=_parse_address,
        help="tcp:127.0.0.1:PORT (0: a free one; a serial bridge for a model without Ethernet), udp:… or pty:PATH",
    )
    parser.add_argument(
        "--baud",
        type=_parse_baud,
        default=38400,
        help="baud rate of a pseudo-terminal or a bridge; both directions are paced",
    )
    parser.add_argument("--frame", type=_parse_frame, default="8N1", help="data bits, parity, stop bits: 8N1, 7O1, …")
    parser.add_argument("--options", type=_parse_options, default={}, help="JSON object: the model's own options")
    parser.add_argument("--timing", type=_fields_parser(TimingFields), default=TimingFields(), help="JSON object")
    parser.add_argument(
        "--oscillator", type=_fields_parser(OscillatorFields), default=OscillatorFields(), help="JSON object"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--truth", type=Path, help="append every motion to this file, one JSON object per line")
    parser.add_argument(
        "--world", type=Path, help="named pipe to create; its lines also change the physical environment"
    )
    parser.add_argument(
        "--unit",
        action="append",
        type=_fields_parser(DeviceFields),
        default=[],
        help="JSON object: one of several controllers on this link, in their order from the host",
    )
    return parser


def requested_devices(chosen: argparse.Namespace) -> list[DeviceFields]:
    """Return the requested controllers: those of `--unit`, or the one of the other arguments."""
    fields = ("name", "options", "timing", "oscillator", "seed", "truth", "world")
    return chosen.unit or [DeviceFields(**{field: getattr(chosen, field) for field in fields})]


def _parse_address(text: str) -> TcpAddress | UdpAddress | PtyAddress:
    kind, _, value = text.partition(":")
    if kind == "pty" and value:
        return PtyAddress(Path(value).absolute())
    host, _, port = value.rpartition(":")
    host = host.strip("[]")
    if kind not in ("tcp", "udp") or not host or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not one of tcp:127.0.0.1:PORT, udp:127.0.0.1:PORT, pty:PATH")
    if host not in _LOOPBACK and not host.startswith("127."):
        raise argparse.ArgumentTypeError(f"{host} would listen to the network; simulators listen at 127.0.0.1 only")
    return (TcpAddress if kind == "tcp" else UdpAddress)(host, int(port))


def _parse_baud(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a baud rate")
    return int(text)


def _parse_frame(text: str) -> int:
    """Return the bits of one character on the serial line."""
    if not re.fullmatch("[78][NEO][12]", text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a frame such as 8N1 or 7O1")
    return 1 + int(text[0]) + (text[1] != "N") + int(text[2])


def _parse_options(text: str) -> dict[str, Any]:
    try:
        value: object = json.loads(text)
    except json.JSONDecodeError as error:
        raise argparse.ArgumentTypeError(f"not JSON: {error}") from None
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError("must be a JSON object")
    return cast(dict[str, Any], value)


def _fields_parser(model: type[M]) -> Callable[[str], M]:
    def parse_fields(text: str) -> M:
        try:
            return model.model_validate_json(text)
        except ValidationError as error:
            raise argparse.ArgumentTypeError(describe_first_error(error)) from None

    return parse_fields
