"""Checks of what the controllers of a fleet are connected to on this computer."""

import os
from collections.abc import Iterable
from pathlib import Path

from orchestrator.model.fleet import CanBusLink, Fleet, SerialLink
from orchestrator.runtime.doctor.findings import Finding


def check_links(fleet: Fleet, hosts: Iterable[str], root: Path = Path("/")) -> list[Finding]:
    """The serial ports and CAN interfaces of the controllers of these adapter hosts. root: of the file system."""
    host_names, findings = set(hosts), dict[str, Finding]()
    for name, config in fleet.controllers.items():
        link = config.link
        if config.host not in host_names:
            continue
        if isinstance(link, SerialLink):
            findings.setdefault(link.device, _check_serial(name, link.device, root))
        elif isinstance(link, CanBusLink) and link.channel.startswith("/"):
            findings.setdefault(link.channel, _check_serial(name, link.channel, root))
        elif isinstance(link, CanBusLink) and link.interface == "socketcan":
            findings.setdefault(link.channel, _check_can(name, link.channel, root))
    return list(findings.values())


def _check_serial(name: str, device: str, root: Path) -> Finding:
    path = root / device.lstrip("/")
    if not path.exists():
        remedy = "plug it in; `ls -l /dev/serial/by-id` shows names that stay"
        return Finding("serial port", "failed", f"{device} ({name}) is not there", remedy)
    if not os.access(path, os.R_OK | os.W_OK):
        remedy = "add this user to its group: `sudo usermod -aG dialout $USER`, then sign in anew"
        return Finding("serial port", "failed", f"{device} ({name}): this user may not use it", remedy)
    return Finding("serial port", "ok", f"{device} ({name})")


def _check_can(name: str, channel: str, root: Path) -> Finding:
    path = root / "sys/class/net" / channel / "operstate"
    try:
        state = path.read_text(encoding="ascii").strip()
    except OSError:
        return Finding(
            "CAN bus", "failed", f"{channel} ({name}) is not there", "load its driver; `ip link` lists interfaces"
        )
    if state == "down":
        remedy = f"`sudo ip link set {channel} up type can bitrate 1000000`"
        return Finding("CAN bus", "failed", f"{channel} ({name}) is down", remedy)
    return Finding("CAN bus", "ok", f"{channel} ({name})")
