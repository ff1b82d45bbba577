"""`tutti service`: Tutti's parts as services of systemd, and udev rules for USB adapters."""

import getpass
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import check_endpoint_option, json_option, print_result
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.systems import require_linux
from orchestrator.runtime.services.parts import PARTS

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet

F = TypeVar("F", bound=Callable[..., Any])

UNITS, RULES = Path("/etc/systemd/system"), Path("/etc/udev/rules.d")
RULES_FILE = "70-tutti.rules"


def _to_option(usual: Path, text: str) -> Callable[[F], F]:
    folder = click.Path(path_type=Path, file_okay=False)
    return click.option("--to", type=folder, default=usual, show_default=True, help=text)


@click.group(epilog="Example: sudo tutti service install lab.fleet.yaml router coordinator gateway recorder")
def service() -> None:
    """Run Tutti's parts as services of systemd."""


@service.command(
    epilog="""\b
Examples:
  sudo tutti service install lab.fleet.yaml router coordinator gateway recorder
  sudo tutti service install lab.fleet.yaml host --host lab2 \\
      --connect tls/192.168.1.5:7447 --identity /etc/tutti/lab2
  tutti service install lab.fleet.yaml coordinator --to ./units"""
)
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.argument("parts", nargs=-1, required=True, type=click.Choice(tuple(PARTS)))
@click.option(
    "--connect", default="tcp/127.0.0.1:7447", show_default=True, callback=check_endpoint_option, help="The router."
)
@click.option(
    "--listen", default="", callback=check_endpoint_option, help="Where the router listens; default: --connect."
)
@click.option("--host", default="", metavar="NAME", help="The adapter host of this computer, for `host`.")
@click.option(
    "--local", multiple=True, metavar="NAME", help="An adapter host that `coordinator` runs here, repeatable."
)
@click.option("--user", default=None, help="The user of the services. Default: this one, or that of sudo.")
@click.option("--identity", type=click.Path(path_type=Path), default=None, help="Folder of the certificate.")
@click.option(
    "--keys", type=click.Path(path_type=Path), default=None, help="Folder of the fleet's authority, for `router`."
)
@click.option(
    "--web-host", default="", help="Address of the page, for `gateway`: by TLS, with the certificate of --identity."
)
@click.option("--web-port", type=click.IntRange(1, 65_535), default=None, help="Port of the page, for `gateway`.")
@_to_option(UNITS, "Folder of the units.")
@json_option
def install(
    file: Path,
    parts: tuple[str, ...],
    connect: str,
    listen: str,
    host: str,
    local: tuple[str, ...],
    user: str | None,
    identity: Path | None,
    keys: Path | None,
    web_host: str,
    web_port: int | None,
    to: Path,
    *,
    as_json: bool,
) -> None:
    """Write the units of PARTS (router, coordinator, host, gateway, recorder) of the fleet in FILE.

    Nothing is started: the commands for that are printed. A unit that is there already is replaced.
    """
    require_linux("services of systemd")
    import os

    from orchestrator.runtime.checked import load_checked_fleet
    from orchestrator.runtime.services.units import ServicePlace, make_unit, make_unit_name

    fleet = load_checked_fleet(file, tolerant=True)
    _require_hosts(fleet, parts, host, local)
    if web_host and identity is None:
        remedy = "give the folder that `tutti keys add-gateway` has made: --identity FOLDER"
        exit_with_error("--web-host needs the gateway's certificate", BAD_INPUT, remedy, code="bad-certificate")
    service_place = ServicePlace(
        fleet=fleet,
        file=file.absolute(),
        command=Path(sys.argv[0]).absolute()
        if Path(sys.argv[0]).name == "tutti"
        else Path(sys.prefix) / "bin" / "tutti",
        python=Path(sys.executable),
        user=user or os.environ.get("SUDO_USER") or getpass.getuser(),
        connect=connect,
        host=host,
        local=local,
        listen=listen,
        keys=None if keys is None else keys.absolute(),
        identity=None if identity is None else identity.absolute(),
        web_host=web_host,
        web_port=web_port,
    )
    written_paths: list[Path] = []
    for part in dict.fromkeys(parts):
        try:
            unit = make_unit(part, service_place)
        except ValueError as error:
            exit_with_error(str(error), BAD_INPUT, "a unit cannot name it", code="bad-name")
        written_paths.append(_write_file(to / make_unit_name(part, service_place), unit))
    names = " ".join(path.name for path in written_paths)
    lines = [f"wrote {path}" for path in written_paths]
    if to == UNITS:
        lines += [
            "start them, now and with the computer:",
            f"  systemctl daemon-reload && systemctl enable --now {names}",
        ]
    else:
        lines.append(f"check them: systemd-analyze verify {' '.join(map(str, written_paths))}")
    print_result({"units": [str(path) for path in written_paths]}, "\n".join(lines), as_json=as_json)


@service.command(epilog="Example: sudo tutti service udev")
@_to_option(RULES, "Folder of the rules.")
@click.option("--print", "only_print", is_flag=True, help="Print the rules, and write nothing.")
@json_option
def udev(to: Path, *, only_print: bool, as_json: bool) -> None:
    """Write udev rules for USB adapters of serial lines: no latency timer, and names that stay."""
    require_linux("rules of udev")
    from orchestrator.runtime.services.units import UDEV_RULES

    if only_print:
        click.echo(UDEV_RULES, nl=False)
        return
    path = _write_file(to / RULES_FILE, UDEV_RULES)
    words = f"wrote {path}\nuse them: udevadm control --reload && udevadm trigger"
    print_result({"rules": str(path)}, words, as_json=as_json)


def _require_hosts(fleet: "Fleet", parts: tuple[str, ...], host: str, local: tuple[str, ...]) -> None:
    """End the command for a host that is missing or unknown."""
    hosts = ", ".join(fleet.hosts)
    if "host" in parts and not host:
        exit_with_error(
            f"`host` needs its name; the fleet has: {hosts}", BAD_INPUT, "give it: --host NAME", code="no-host"
        )
    unknown = next((name for name in (*local, *([host] if host else [])) if name not in fleet.hosts), None)
    if unknown is not None:
        exit_with_error(f"no controller has `host: {unknown}`; hosts: {hosts}", BAD_INPUT, "correct it", code="no-host")


def _write_file(path: Path, text: str) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        exit_with_error(
            f"{path} cannot be written: {error.strerror}",
            FAILED,
            "run it as root (sudo), or choose a folder: --to",
            code="not-written",
        )
    return path
