"""Links to controllers, as defined in the fleet file."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from orchestrator.model.base import Model
from orchestrator.model.text.addresses import check_host


def _check_device(text: str) -> str:
    if "://" in text:
        kind = text.partition(":")[0]
        words = f"{kind}:// is an address of a network, and `device` a port of this computer"
        raise ValueError(f"{words}; write `link: {{kind: tcp, host: …, port: …}}` with the raw port of the server")
    return text


Host = Annotated[
    str,
    Field(min_length=1, max_length=253, description="Address of the controller, e.g. 192.168.1.20."),
    AfterValidator(check_host),
]


class TcpLink(Model):
    """A controller behind a TCP port."""

    kind: Literal["tcp"] = "tcp"
    host: Host
    port: int = Field(ge=1, le=65535)

    @property
    def endpoint(self) -> str:
        """The endpoint; two controllers cannot share it."""
        return f"tcp {self.host}:{self.port}"


class UdpLink(Model):
    """A controller behind a UDP port."""

    kind: Literal["udp"]
    host: Host
    port: int = Field(ge=1, le=65535)

    @property
    def endpoint(self) -> str:
        """The endpoint; two controllers cannot share it."""
        return f"udp {self.host}:{self.port}"


LINE_SETTINGS = ("baud", "data_bits", "parity", "stop_bits", "rtscts")


class SerialLink(Model):
    """A controller on a serial port. A fleet file may leave out the line settings: they are then those of the make."""

    kind: Literal["serial"]
    device: Annotated[str, AfterValidator(_check_device)] = Field(
        description="The port, preferably by a stable name, e.g. /dev/serial/by-id/…."
    )
    baud: int = Field(default=38400, gt=0, le=10_000_000, description="Default: that of the make.")
    data_bits: Literal[7, 8] = 8
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    rtscts: bool = Field(default=False, description="Hardware handshake with RTS and CTS.")
    address: int | None = Field(
        default=None, ge=0, le=255, description="Address of the controller, where several share the port."
    )

    @property
    def endpoint(self) -> str:
        """The port; controllers can share it only if their make supports it and each has an address."""
        return f"serial {self.device}"


class CanBusLink(Model):
    """A controller that is a node of a CAN bus; several can be on one bus."""

    kind: Literal["can"]
    interface: str = Field(description="slcan, socketcan, or any other interface that python-can supports.")
    channel: str = Field(description="The interface's name for the bus: can0, /dev/serial/by-id/…, …")
    bitrate: int = Field(default=1_000_000, ge=10_000, le=1_000_000, description="Of all nodes of the bus, bit/s.")
    address: int = Field(ge=1, le=127, description="Node number.")

    @property
    def endpoint(self) -> str:
        """The bus."""
        return f"can {self.channel}"


class InProcessLink(Model):
    """A simulated controller in the process of its adapter, of a model that can be there; for benchmarks and tests."""

    kind: Literal["process"]
    device: str = Field(min_length=1, max_length=64, description="A name that no other controller of the file has.")

    @property
    def endpoint(self) -> str:
        """The device; two controllers cannot share it."""
        return f"process {self.device}"


AnyLink = TcpLink | UdpLink | SerialLink | CanBusLink | InProcessLink
Link = Annotated[AnyLink, Field(discriminator="kind")]
