"""The arguments of a simulator's process, checked."""

import argparse
import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError

_LOOPBACK = ("localhost", "::1")

NEXT = "--next"
"""Parts the arguments of several links."""

M = TypeVar("M", bound=BaseModel)


class TimingFields(BaseModel):
    """`--timing`: how long the firmware takes, ns."""

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
    `level_when_on`. world: the named pipe of the other one's world."""

    model_config = ConfigDict(extra="forbid")

    output: int = Field(ge=0)
    world: Path
    input: int = Field(ge=0)
    level_when_on: bool = True
    delay_us: int = Field(default=0, ge=0, le=100_000)


class UnitFields(BaseModel):
    """`--unit`: one of several controllers that share the link. truth, world: as the arguments of these names."""

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
class TcpPlace:
    """Listen at a TCP port of this host; port 0: a free one."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class UdpPlace:
    """Take datagrams at a UDP port of this host; port 0: a free one."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class PtyPlace:
    """Be a pseudo-terminal that this path points to."""

    link: Path


class OneLineParser(argparse.ArgumentParser):
    """Says what is wrong in one line, and ends with code 2."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: {message}\n")
        raise SystemExit(2)


def parse_arguments(arguments: Sequence[str] | None) -> list[argparse.Namespace]:
    """The arguments, of each link that they ask for. Ends the process with code 2 and one line on stderr when one is
    wrong."""
    links: list[list[str]] = [[]]
    for argument in sys.argv[1:] if arguments is None else arguments:
        if argument == NEXT:
            links.append([])
        else:
            links[-1].append(argument)
    parser = _parser()
    return [parser.parse_args(link) for link in links]


def _parser() -> argparse.ArgumentParser:
    parser = OneLineParser(
        prog="python -m sim.link.process",
        description="One simulated controller on a real link.",
        epilog=f"{NEXT} parts the arguments of several links that one process serves.",
    )
    parser.add_argument("--model", required=True, help="a simulated model, e.g. smc4000")
    parser.add_argument("--name", required=True, help="the controller's name in the fleet file")
    parser.add_argument(
        "--listen",
        required=True,
        type=_place,
        help="tcp:127.0.0.1:PORT (0: a free one; a serial bridge for a model without Ethernet), udp:… or pty:PATH",
    )
    parser.add_argument(
        "--baud", type=_baud, default=38400, help="of a pseudo-terminal or a bridge; both directions are paced"
    )
    parser.add_argument("--frame", type=_frame, default="8N1", help="data bits, parity, stop bits: 8N1, 7O1, …")
    parser.add_argument("--options", type=_options, default={}, help="JSON object: the model's own options")
    parser.add_argument("--timing", type=_fields(TimingFields), default=TimingFields(), help="JSON object")
    parser.add_argument("--oscillator", type=_fields(OscillatorFields), default=OscillatorFields(), help="JSON object")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--truth", type=Path, help="append every motion to this file, one JSON object a line")
    parser.add_argument("--world", type=Path, help="a named pipe to make: its lines change the physical world too")
    parser.add_argument(
        "--unit",
        action="append",
        type=_fields(UnitFields),
        default=[],
        help="JSON object: one of several controllers on this link, in their order from the host",
    )
    return parser


def units(chosen: argparse.Namespace) -> list[UnitFields]:
    """The controllers that are asked for: those of `--unit`, or the one of the other arguments."""
    fields = ("name", "options", "timing", "oscillator", "seed", "truth", "world")
    return chosen.unit or [UnitFields(**{field: getattr(chosen, field) for field in fields})]


def _place(text: str) -> TcpPlace | UdpPlace | PtyPlace:
    kind, _, rest = text.partition(":")
    if kind == "pty" and rest:
        return PtyPlace(Path(rest).absolute())
    host, _, port = rest.rpartition(":")
    host = host.strip("[]")
    if kind not in ("tcp", "udp") or not host or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is none of tcp:127.0.0.1:PORT, udp:127.0.0.1:PORT, pty:PATH")
    if host not in _LOOPBACK and not host.startswith("127."):
        raise argparse.ArgumentTypeError(f"{host} would listen to the network; simulators listen at 127.0.0.1 only")
    return (TcpPlace if kind == "tcp" else UdpPlace)(host, int(port))


def _baud(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no baud rate")
    return int(text)


def _frame(text: str) -> int:
    """Bits of one character on the wire."""
    if not re.fullmatch("[78][NEO][12]", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no frame such as 8N1 or 7O1")
    return 1 + int(text[0]) + (text[1] != "N") + int(text[2])


def _options(text: str) -> dict[str, Any]:
    try:
        value: object = json.loads(text)
    except json.JSONDecodeError as error:
        raise argparse.ArgumentTypeError(f"not JSON: {error}") from None
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError("must be a JSON object")
    return cast(dict[str, Any], value)


def _fields(model: type[M]) -> Callable[[str], M]:
    def parse(text: str) -> M:
        try:
            return model.model_validate_json(text)
        except ValidationError as error:
            raise argparse.ArgumentTypeError(first_problem(error)) from None

    return parse


def first_problem(error: ValidationError) -> str:
    """The first thing that is wrong, in one line."""
    first = error.errors()[0]
    field = ".".join(map(str, first["loc"]))
    return f"{field}: {first['msg']}" if field else first["msg"]
