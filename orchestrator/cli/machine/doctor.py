"""`tutti doctor`: check a computer, and say what to do."""

import asyncio
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import FAILED
from orchestrator.cli.base.common import check_endpoint_option, console, json_option, print_json
from orchestrator.cli.base.extras import require_extra

if TYPE_CHECKING:
    from orchestrator.runtime.doctor.findings import Finding

_SIGNS = {"ok": "[green]ok[/]", "warning": "[yellow]warning[/]", "failed": "[red]failed[/]"}


@click.command(
    epilog="""\b
Examples:
  tutti doctor
  tutti doctor lab.fleet.yaml --host lab2 --connect tls/192.168.1.5:7447
  tutti doctor lab.fleet.yaml --journal postgresql://tutti@a,b/tutti

\b
Exit codes: 0 nothing has failed, perhaps with warnings; 1 something has."""
)
@click.argument("file", required=False, type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option(
    "--host", "hosts", multiple=True, metavar="NAME", help="Check the links of this adapter host; default: all."
)
@click.option(
    "--connect",
    default="",
    callback=check_endpoint_option,
    help="Check the router there, the versions of all parts, and TLS.",
)
@click.option(
    "--journal",
    default="",
    metavar="ADDRESS",
    help="Check the database of the journal, postgresql://USER@HOST,HOST/DATABASE; with FILE for its copies.",
)
@click.option("--state", type=click.Path(path_type=Path), default=None, help="The state folder; its disk is measured.")
@json_option
def doctor(
    file: Path | None, hosts: tuple[str, ...], connect: str, journal: str, state: Path | None, *, as_json: bool
) -> None:
    """Check this computer: system, Python, real-time limits, USB latency timers, permissions, ports, clock source,
    disk, the certificate, the router, versions, and whether other computers reach the bus without TLS; with FILE also
    the links of its controllers. Nothing is changed.
    """
    findings = _examine(file, hosts, connect, state) + (_examine_journal(file, journal) if journal else [])
    if as_json:
        print_json(
            {
                "findings": [
                    {"check": finding.check, "state": finding.state, "text": finding.text, "remedy": finding.remedy}
                    for finding in findings
                ]
            }
        )
    else:
        _print_findings(findings)
    if any(finding.state == "failed" for finding in findings):
        raise SystemExit(FAILED)


def _examine(file: Path | None, hosts: tuple[str, ...], connect: str, state: Path | None) -> "list[Finding]":
    from orchestrator.bus.endpoint import DEFAULT_ENDPOINT
    from orchestrator.runtime.doctor import system
    from orchestrator.runtime.doctor.links import check_links
    from orchestrator.runtime.doctor.parts import check_parts
    from orchestrator.runtime.doctor.router import check_openness, check_router
    from orchestrator.runtime.state.folder import default_state

    fleet = None
    if file is not None:
        from orchestrator.runtime.checked import load_checked_fleet

        fleet = load_checked_fleet(file, tolerant=True)
    folder = state or default_state("any" if fleet is None else fleet.fleet)
    findings = [system.check_system(), system.check_python(), system.check_versions(), system.check_disk(folder)]
    if (keys := system.check_keys()) is not None:
        findings.append(keys)
    if sys.platform == "linux":  # where a fleet can run
        findings += [system.check_realtime(), system.check_clock_source(), *system.check_usb_latency()]
        findings += system.check_ports((("router", int(DEFAULT_ENDPOINT.rpartition(":")[2])), ("page", 8080)))
    if fleet is not None:
        findings += check_links(fleet, hosts or fleet.hosts)
    if connect:
        router = asyncio.run(check_router(connect))
        findings += (
            [router]
            if router.state == "failed"
            else [router, *asyncio.run(check_parts(connect)), asyncio.run(check_openness(connect))]
        )
    return findings


def _examine_journal(file: Path | None, address: str) -> "list[Finding]":
    require_extra("postgres", "psycopg")
    from orchestrator.model.queue import JournalPolicy
    from orchestrator.runtime.checked import load_checked_fleet
    from orchestrator.runtime.doctor.journal import check_journal_server

    fleet = None if file is None else load_checked_fleet(file, tolerant=True)
    name, policy = ("any", JournalPolicy()) if fleet is None else (fleet.fleet, fleet.journal)
    return check_journal_server(address, name, policy)


def _print_findings(found: "list[Finding]") -> None:
    from orchestrator.monitor.tables import make_plain_table

    table = make_plain_table(["", "check", "found"])
    for finding in found:
        table.add_row(
            _SIGNS[finding.state], finding.check, finding.text + (f"\n→ {finding.remedy}" if finding.remedy else "")
        )
    console.print(table)
