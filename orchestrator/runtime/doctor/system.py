"""Checks of the computer itself: Python, priorities, clock source, disk, ports. `root`: of the file system."""

import os
import platform
import socket
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from shutil import disk_usage
from statistics import median
from tempfile import NamedTemporaryFile

from orchestrator.bus.identity import find_identity
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.live import raw_ns
from orchestrator.clock.realtime import RealtimePriority, can_set_realtime_priority
from orchestrator.model.files.private_files import HAS_MODES
from orchestrator.runtime.doctor.findings import Finding

LEAST_PYTHON = (3, 11)
SLOW_SYNC_S, VERY_SLOW_SYNC_S = 0.02, 0.1  # of a write to the journal: each step of a job waits for one
SYNCS = 9
STEADY_SOURCES = ("tsc", "arch_sys_counter", "kvm-clock")
LEAST_FREE_BYTES = 500_000_000
PARTS = ("eclipse-zenoh", "ruckig", "pydantic", "numpy", "click", "rich", "pyserial", "python-can")


def check_python() -> Finding:
    """The version of Python."""
    text = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] < LEAST_PYTHON:
        return Finding(
            "python", "failed", f"Python {text} is too old", f"use {'.'.join(map(str, LEAST_PYTHON))} or newer"
        )
    return Finding("python", "ok", f"Python {text} in {sys.prefix}")


def check_system() -> Finding:
    """The operating system."""
    name = platform.system().replace("Darwin", "macOS")
    if sys.platform == "linux":
        return Finding("system", "ok", f"{name} {platform.release()}")
    return Finding("system", "warning", f"{name}: clients run here, a fleet does not", "run the fleet on Linux")


def check_keys() -> Finding | None:
    """Where a file has no mode: whether the identity of this user is in the profile, which other users cannot read."""
    identity = find_identity()
    if HAS_MODES or identity is None or identity.absolute().is_relative_to(Path.home()):
        return None
    text = f"{identity} is outside of {Path.home()}: perhaps other users can read the key in it"
    return Finding("keys", "warning", text, "move the folder there, or take their permission in its properties")


def check_versions() -> Finding:
    """The versions of Tutti and of what it is built on."""
    versions: list[str] = []
    for name in ("tutti", *PARTS):
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            if name == "tutti":
                return Finding(
                    "versions", "failed", "the package tutti is not installed", "install it: pip install tutti"
                )
    return Finding("versions", "ok", ", ".join(versions))


def check_realtime() -> Finding:
    """Whether this user may run processes in real time."""
    if can_set_realtime_priority(RealtimePriority.FIRING):
        return Finding("real time", "ok", f"this user may use priorities up to {int(RealtimePriority.FIRING)}")
    return Finding(
        "real time",
        "warning",
        "this user may not run processes in real time: stops and starts can be late on a busy computer",
        "grant an rtprio limit of 4: `LimitRTPRIO=4` in a unit, or `@tutti - rtprio 4` in /etc/security/limits.d",
    )


def check_clock_source(root: Path = Path("/")) -> Finding:
    """The clock source of the kernel: a slow one makes each reading of the time slow, and coarse."""
    path = root / "sys/devices/system/clocksource/clocksource0/current_clocksource"
    try:
        source = path.read_text(encoding="ascii").strip()
    except OSError:
        return Finding("clock source", "warning", "not known: the kernel does not tell", "")
    if source in STEADY_SOURCES:
        return Finding("clock source", "ok", source)
    remedy = "see `dmesg | grep -i tsc`; in a virtual machine give it the invariant TSC of the processor"
    return Finding("clock source", "warning", f"{source}: reading the time takes microseconds", remedy)


def check_usb_latency(root: Path = Path("/")) -> list[Finding]:
    """The latency timers of FTDI adapters: by default they keep received bytes for up to 16 ms."""
    latency: list[Finding] = []
    for path in sorted((root / "sys/bus/usb-serial/devices").glob("*/latency_timer")):
        name = path.parent.name
        try:
            timer_ms = int(path.read_text(encoding="ascii"))
        except (OSError, ValueError):
            continue
        if timer_ms > 1:
            remedy = "`sudo tutti service udev` sets it to 1 whenever an adapter is plugged in"
            latency.append(Finding("USB latency", "warning", f"{name} keeps received bytes for {timer_ms} ms", remedy))
        else:
            latency.append(Finding("USB latency", "ok", f"{name}: {timer_ms} ms"))
    return latency


def check_disk(folder: Path) -> Finding:
    """How long a write to the disk of the state folder takes, and how much is free there."""
    parent = next(path for path in (folder, *folder.parents) if path.exists())
    took: list[float] = []
    try:
        with NamedTemporaryFile(dir=parent) as file:
            for _ in range(SYNCS):
                began_ns = raw_ns()
                file.write(b"x" * 4096)
                file.flush()
                os.fsync(file.fileno())
                took.append((raw_ns() - began_ns) / NS_PER_S)
        free = disk_usage(parent).free
    except OSError as error:
        return Finding(
            "disk", "failed", f"{parent} cannot be written: {error.strerror}", "choose another folder: --state"
        )
    middle_s = median(took)
    text = f"{middle_s * 1e3:.1f} ms a write in {parent}, {free // 1_000_000} MB free"
    if free < LEAST_FREE_BYTES:
        return Finding("disk", "failed", text, "free space there: no job begins on a full disk")
    if middle_s > SLOW_SYNC_S:
        state = "failed" if middle_s > VERY_SLOW_SYNC_S else "warning"
        return Finding(
            "disk", state, text, "put the state folder on a faster disk (no network file system, no SD card)"
        )
    return Finding("disk", "ok", text)


def check_ports(ports: Sequence[tuple[str, int]]) -> list[Finding]:
    """Whether ports of 127.0.0.1 are free, each with what would use it."""
    findings: list[Finding] = []
    for service, port in ports:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError as error:
                text = f"port {port} ({service}) is in use: {error.strerror}"
                findings.append(
                    Finding("ports", "warning", text, "fine if a fleet runs here; else choose another: --port")
                )
            else:
                findings.append(Finding("ports", "ok", f"port {port} ({service}) is free"))
    return findings
