"""The units of systemd for the parts of a fleet, each a service of its own (`systemd.service(5)`, `systemd.exec(5)`).

A part announces that it is ready, and feeds its watchdog by progress (`Type=notify`, `WatchdogSec`). Its child
processes are its own to end, in order (`KillMode=mixed`); the time for that is longer than the longest ramp of the
fleet.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path

from orchestrator.bus.identity import CERTIFICATE_FILE, KEY_FILE
from orchestrator.model.fleet import CanBusLink, Fleet, SerialLink
from orchestrator.runtime.services.parts import (
    GATEWAY,
    PARTS,
    RECORDER,
    list_certificate_options,
    list_gateway_options,
    list_recorder_options,
)

_PLAIN_WORD = re.compile(r"[\w@%+,./:=$-]+")
STOP_MARGIN_S = 15  # beyond the longest ramp: for processes to end in order

# What no part needs. `security` of systemd-analyze is the list to compare with.
_CONFINEMENT = """\
NoNewPrivileges=yes
ProtectSystem=strict
ProtectHome=read-only
PrivateTmp=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
ProtectClock=yes
ProtectHostname=yes
RestrictSUIDSGID=yes
RestrictNamespaces=yes
LockPersonality=yes
SystemCallArchitectures=native
CapabilityBoundingSet=
UMask=0077
"""


@dataclass(frozen=True, slots=True)
class ServicePlace:
    """Where the services of a fleet run, and as which user.

    command: the `tutti` command; python: its interpreter. file: the fleet file. connect: the router. identity: the
    folder of its certificate; None: without. host: the adapter host of this computer. local: the hosts that the
    coordinator's service runs. listen: where the router listens. keys: the folder of the fleet's authority, for the
    router. web_host: the address of the page, by TLS with the certificate of `identity`; empty: 127.0.0.1, without.
    web_port: None: the first free one of 8080 to 8089.
    """

    fleet: Fleet
    file: Path
    command: Path
    python: Path
    user: str
    connect: str
    host: str = ""
    local: Sequence[str] = ()
    listen: str = ""
    keys: Path | None = None
    identity: Path | None = None
    web_host: str = ""
    web_port: int | None = None


def make_unit_name(part: str, place: ServicePlace) -> str:
    """The file name of a unit, e.g. `tutti-lab-host-lab2.service`."""
    suffix = f"-{place.host}" if part == "host" else ""
    return f"tutti-{place.fleet.fleet}-{part}{suffix}.service"


def make_unit(part: str, place: ServicePlace) -> str:
    """The unit of a part. Raises `ValueError` for a part that is none of `PARTS`."""
    command = " ".join(quote_word(word).replace("$", "$$") for word in _make_command(part, place))
    targets = (
        "network-online.target"
        if part == "router"
        else f"network-online.target tutti-{place.fleet.fleet}-router.service"
    )
    environment = ["XDG_STATE_HOME=%S", "TUTTI_LOG=journal"]
    if place.identity is not None:
        environment.append(quote_word(f"TUTTI_IDENTITY={place.identity}"))
    lines = [
        "[Unit]",
        f"Description=Tutti {part}{' ' + place.host if part == 'host' else ''} of fleet {place.fleet.fleet}",
        f"After={targets}",
        "Wants=network-online.target",
        "",
        "[Service]",
        "Type=notify",
        "NotifyAccess=all",
        f"ExecStart={command}",
        *(f"Environment={setting}" for setting in environment),
        f"User={place.user}",
        f"StateDirectory=tutti/{_state_name(part, place)}",
        "StateDirectoryMode=0700",
        f"WatchdogSec={PARTS[part].watchdog_s}",
        "KillMode=mixed",
        f"TimeoutStopSec={find_stop_s(place.fleet)}",
        "TimeoutStartSec=90",
        "Restart=always",
        "RestartSec=1",
        "# Bad input, a port or a leadership that is taken, a journal that cannot be used: a restart gives the same.",
        "RestartPreventExitStatus=2 4 5",
        "# Real-time priorities: an e-stop does not wait for other programs.",
        "LimitRTPRIO=4",
        "RestrictRealtime=no",
        *_list_devices(part, place),
        *_CONFINEMENT.splitlines(),
        "",
        "[Install]",
        "WantedBy=multi-user.target",
    ]
    return "\n".join(lines) + "\n"


def quote_word(word: str) -> str:
    """A word of a command line or a setting as systemd reads it back (`systemd.service(5)`, COMMAND LINES;
    `systemd.unit(5)`, SPECIFIERS): quoted in its own way, which is not that of a shell.

    Raises `ValueError` for a word with a line break."""
    if "\n" in word or "\r" in word:
        raise ValueError(f"{word!r} has a line break, which no unit can have; rename it")
    text = word.replace("%", "%%")
    if _PLAIN_WORD.fullmatch(text):
        return text
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def find_stop_s(fleet: Fleet) -> int:
    """How long a part may take to end: the longest ramp of any axis, and some seconds for processes."""
    ramps_s = [
        axis.limits.velocity / axis.limits.acceleration
        for config in fleet.controllers.values()
        for axis in config.axes.values()
    ]
    return ceil(max(ramps_s)) + STOP_MARGIN_S


def _state_name(part: str, place: ServicePlace) -> str:
    return f"{place.fleet.fleet}@{place.host}" if part == "host" else place.fleet.fleet


def _make_command(part: str, place: ServicePlace) -> list[str]:
    tutti, name, state = str(place.command), place.fleet.fleet, f"/var/lib/tutti/{place.fleet.fleet}"
    python, log = str(place.python), f"{state}/log/{part}.jsonl"
    match part:
        case "router":
            keys = [] if place.keys is None else ["--keys", str(place.keys)]
            return [tutti, "router", str(place.file), "--listen", place.listen or place.connect, *keys]
        case "coordinator":
            hosts = [word for host in place.local for word in ("--host", host)] or ["--no-hosts"]
            command = [tutti, "up", str(place.file), "--connect", place.connect]
            return [*command, *hosts, "--no-web", "--no-record"]
        case "host":
            return [tutti, "host", place.host, "--fleet", name, "--connect", place.connect]
        case "gateway":
            options = [*list_gateway_options(name, place.connect, state, log), "--service", *_list_web_options(place)]
            return GATEWAY.make_command(python, *options, switches=["-P"])
        case "recorder":
            folder, quota = f"{state}/recordings", 2_000_000_000
            options = list_recorder_options(name, str(place.file), place.connect, folder, quota)
            return RECORDER.make_command(python, *options, "--log", log, "--service", switches=["-P"])
        case _:
            raise ValueError(f"no part {part}; parts: {', '.join(PARTS)}")


def _list_web_options(place: ServicePlace) -> list[str]:
    options = [] if place.web_port is None else ["--port", str(place.web_port)]
    if place.web_host and place.identity is not None:
        certificate, key = place.identity / CERTIFICATE_FILE, place.identity / KEY_FILE
        options += ["--address", place.web_host, *list_certificate_options(str(certificate), str(key))]
    return options


def _list_devices(part: str, place: ServicePlace) -> list[str]:
    """What the links of the controllers here need; all others get no device."""
    hosts = {"host": [place.host], "coordinator": list(place.local)}.get(part, [])
    links = [controller.link for controller in place.fleet.controllers.values() if controller.host in hosts]
    serial = any(
        isinstance(link, SerialLink) or (isinstance(link, CanBusLink) and link.channel.startswith("/"))
        for link in links
    )
    families = ["AF_UNIX", "AF_INET", "AF_INET6", "AF_NETLINK"]
    if any(isinstance(link, CanBusLink) for link in links):
        families.append("AF_CAN")
    lines = ["DevicePolicy=closed", f"RestrictAddressFamilies={' '.join(families)}"]
    if serial:
        lines += ["DeviceAllow=char-ttyUSB rw", "DeviceAllow=char-ttyACM rw", "DeviceAllow=char-ttyS rw"]
        lines.append("SupplementaryGroups=dialout")
    else:
        lines.append("PrivateDevices=yes")
    return lines


UDEV_RULES = """\
# Tutti: USB adapters of serial lines deliver received bytes at once, and not up to 16 ms later (latency timer of FTDI).
ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"
# A name that stays when the adapter is plugged into another port: /dev/tutti-SERIAL.
SUBSYSTEM=="tty", SUBSYSTEMS=="usb", ENV{ID_SERIAL_SHORT}=="?*", \\
  SYMLINK+="tutti-$env{ID_SERIAL_SHORT}", GROUP="dialout", MODE="0660"
"""
