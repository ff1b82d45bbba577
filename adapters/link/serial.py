"""Links over serial ports."""

import contextlib
import errno
import os
from pathlib import Path
from typing import Literal

import serial

from adapters.link.descriptor import DescriptorLink, OpenDescriptor
from adapters.link.holders import find_holders
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.link.base import Link, LinkRefused
from orchestrator.model.fleet import SerialLink

_PARITY: dict[str, Literal["N", "E", "O"]] = {"none": "N", "even": "E", "odd": "O"}


def frame_bits(link: SerialLink) -> int:
    """Return the bits of one character in transmission, with start, parity and stop bits."""
    return 1 + link.data_bits + (link.parity != "none") + link.stop_bits


def open_serial(link: SerialLink, clock: Clock) -> Link:
    """Open the port for exclusive use by this process. Raises `LinkRefused`."""
    char_ns = frame_bits(link) * NS_PER_S // link.baud
    device = Path(link.device)
    pseudo = device.resolve().is_relative_to("/dev/pts")
    try:
        port = serial.Serial(
            link.device,
            link.baud,
            # Pseudo-terminals have eight bits, no parity and no handshake lines, and reject such settings.
            bytesize=8 if pseudo else link.data_bits,
            parity="N" if pseudo else _PARITY[link.parity],
            stopbits=1 if pseudo else link.stop_bits,
            rtscts=link.rtscts and not pseudo,
            exclusive=True,
        )
    except (OSError, ValueError) as error:
        raise LinkRefused(f"{link.endpoint}: {_refusal_text(link, device, error)}") from None
    if not pseudo:
        # Without this mode, USB adapters buffer received bytes for up to 16 ms. Many drivers do not support it.
        with contextlib.suppress(OSError, ValueError):
            port.set_low_latency_mode(True)
    os.set_blocking(port.fileno(), False)
    return DescriptorLink(link.endpoint, char_ns, OpenDescriptor(port.fileno(), port.close), clock)


def _refusal_text(link: SerialLink, device: Path, error: Exception) -> str:
    """Return why the port could not be opened, and what to do."""
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return "no such device; is its cable plugged in? List the existing ports: `ls /dev/serial/by-id /dev/tty*`"
    if number in (errno.EACCES, errno.EPERM):
        return "permission denied; add the user to the group that owns the port (usually dialout), then log in again"
    if number in (errno.EBUSY, errno.EAGAIN):
        return f"in use by {', '.join(find_holders(device)) or 'a process of another user'}; end that process first"
    if number == errno.EISDIR or not device.is_char_device():
        return "is not a serial port; correct `device` in the fleet file"
    return f"cannot be set to {link.baud} baud, {link.data_bits} bits, parity {link.parity}: {error}"
