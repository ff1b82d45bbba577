"""`tutti adapter …`: makes of others: a new package, its check, what is installed, and a look at a controller."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, UNREACHABLE
from orchestrator.cli.base.common import console, json_option, print_json
from orchestrator.cli.base.errors import exit_with_error, run_main
from orchestrator.cli.base.systems import require_linux

if TYPE_CHECKING:
    from orchestrator.conformance.suite import CheckResult
    from orchestrator.model.plugins import PluginListing

MARKS = {"holds": "holds", "broken": "BROKEN", "not-applicable": "n/a"}


@click.group(epilog="Example: tutti adapter new mc2000")
def adapter() -> None:
    """Makes that Tutti does not know: write an adapter and a simulator, check them, list what is installed."""


@adapter.command(epilog="Example: tutti adapter new mc2000 --into ~/src/tutti-mc2000")
@click.argument("name")
@click.option("--into", type=click.Path(path_type=Path), default=None, help="The new folder; default: NAME.")
@json_option
def new(name: str, into: Path | None, *, as_json: bool) -> None:
    """Write a package for the make NAME: an adapter, a simulator, vectors, tests and a README.

    It is for a made-up controller with simple text lines, and passes its tests.
    """
    from orchestrator.runtime.adapter_package import BadPackage, write_package

    folder = into or Path(name)
    try:
        files = write_package(name, folder)
    except BadPackage as error:
        exit_with_error(str(error), BAD_INPUT, error.remedy)
    if as_json:
        print_json({"folder": str(folder), "files": [str(file.relative_to(folder)) for file in files]})
        return
    _print_plain(f"{folder}: {len(files)} files")
    _print_plain(f"next: pip install --no-build-isolation -e {folder}")
    _print_plain(f"      pytest {folder}")
    _print_plain(f"      tutti adapter check {name}")


@adapter.command(epilog="Example: tutti adapter check mc2000 --all")
@click.argument("make_or_package", metavar="MAKE|PACKAGE")
@click.option("--all", "everything", is_flag=True, help="Also the variants that take minutes.")
@json_option
def check(make_or_package: str, *, everything: bool, as_json: bool) -> None:
    """Run the contract suite on an installed make, or on all makes of a package: every guarantee of a driver, judged by
    the ground truth of its simulator, in virtual time.

    Exit 1 if something does not hold.
    """
    from orchestrator.conformance.suite import list_checks, run_check
    from orchestrator.model.plugins import PluginError, UnknownPlugin

    results: dict[str, list[CheckResult]] = {}
    for make in _find_makes(make_or_package):
        try:
            checks = list_checks(make, everything=everything)
        except UnknownPlugin as error:
            exit_with_error(str(error), BAD_INPUT)
        except PluginError as error:
            exit_with_error(error.text, FAILED, error.remedy, code="plug-in")
        results[make] = []
        for check in checks:
            result = run_check(check)
            results[make].append(result)
            if not as_json:
                _print_result(result)
    broken_findings = [finding for findings in results.values() for finding in findings if finding.state == "broken"]
    if as_json:
        plain = {
            make: [{"part": e.part, "check": e.name, "state": e.state, "text": e.text} for e in findings]
            for make, findings in results.items()
        }
        print_json({"makes": plain, "broken": len(broken_findings)})
    else:
        for make, findings in results.items():
            counts = {state: sum(finding.state == state for finding in findings) for state in MARKS}
            _print_plain(
                f"{make}: {counts['holds']} hold, {counts['broken']} do not, {counts['not-applicable']} do not apply"
            )
    if broken_findings:
        raise SystemExit(FAILED)


@adapter.command(epilog="Example: tutti adapter ls")
@json_option
def ls(*, as_json: bool) -> None:
    """List all installed makes and simulators with their packages, and what is wrong with them. Exit 1 if something
    is."""
    from adapters.host.makes import list_makes
    from orchestrator.model.plugins import API_VERSION
    from orchestrator.monitor.tables import make_plain_table
    from sim.core.vectors import list_simulators

    listings = [*list_makes(), *list_simulators()]
    if as_json:
        print_json({"api_version": API_VERSION, "plug_ins": [_to_plain(listing) for listing in listings]})
    else:
        table = make_plain_table(["make", "kind", "package", "from"])
        for listing in listings:
            table.add_row(
                listing.name, listing.group.removeprefix("tutti.").removesuffix("s"), listing.package, listing.target
            )
        console.print(table)
        _print_plain(f"version {API_VERSION} of the contract")
        for listing in listings:
            if listing.problem:
                _print_plain(f"{listing.name}: {listing.problem}")
    if any(listing.problem for listing in listings):
        raise SystemExit(FAILED)


@adapter.command(epilog=r"Example: tutti adapter probe /dev/ttyUSB0,115200 '?'")
@click.argument("endpoint")
@click.argument("query")
@click.option("--end", default=r"\n", show_default=True, help="What ends the query; escapes as in QUERY.")
@click.option(
    "--wait", "wait_s", type=click.FloatRange(0.01, 600), default=1.0, show_default=True, help="For the reply, s."
)
@json_option
def probe(endpoint: str, query: str, end: str, wait_s: float, *, as_json: bool) -> None:
    r"""Send QUERY to the controller at ENDPOINT, and show the bytes of its reply with their times.

    ENDPOINT is tcp:HOST:PORT, udp:HOST:PORT, or a serial device with baud rate and frame: /dev/ttyS0,9600,7O1. QUERY
    may have the escapes \r, \n, \t, \0, \\ and \x18. It is sent as it is: it may move the controller.
    """
    require_linux("an exchange with a controller", "use the terminal program of its maker")
    from orchestrator.link.base import LinkClosed, LinkRefused
    from orchestrator.runtime.probe import (
        BadProbe,
        format_after,
        parse_probe_endpoint,
        parse_probe_query,
        probe_controller,
    )

    try:
        link, data = parse_probe_endpoint(endpoint), parse_probe_query(query + end)
    except BadProbe as error:
        exit_with_error(str(error), BAD_INPUT)
    try:
        parts = run_main(probe_controller(link, data, wait_s))
    except (LinkRefused, LinkClosed) as error:
        exit_with_error(str(error), UNREACHABLE)
    if as_json:
        plain_parts = [{"after_ns": part.after_ns, "data": part.data.decode("latin-1")} for part in parts]
        print_json({"sent": data.decode("latin-1"), "received": plain_parts})
    else:
        _print_plain(f"{'0.000 ms':>14}  sent      {data!r}")
        for part in parts:
            _print_plain(f"{format_after(part.after_ns):>14}  received  {part.data!r}")
    if not parts:
        if not as_json:
            text = f"no reply within {wait_s:g} s"
            exit_with_error(text, UNREACHABLE, "check power, cable and baud rate, and what ends a command (--end)")
        raise SystemExit(UNREACHABLE)


def _find_makes(name: str) -> list[str]:
    """Return the makes of a package, or the make itself."""
    from importlib.metadata import PackageNotFoundError, distribution

    from adapters.host.makes import known_makes

    if name in known_makes():
        return [name]
    try:
        entries = distribution(name).entry_points
    except (PackageNotFoundError, ValueError):
        return [name]
    makes = [entry.name for entry in entries if entry.group == "tutti.adapters"]
    if not makes:
        exit_with_error(f"the package {name} provides no adapter", BAD_INPUT, "see its entry points `tutti.adapters`")
    return makes


def _to_plain(listing: "PluginListing") -> dict[str, str]:
    return {
        "group": listing.group,
        "name": listing.name,
        "package": listing.package,
        "target": listing.target,
        "problem": listing.problem,
    }


def _print_result(result: "CheckResult") -> None:
    _print_plain(f"{MARKS[result.state]:>7}  {result.part}: {result.name}")
    if result.text:
        _print_plain(f"{'':>9}{result.text}")


def _print_plain(text: str) -> None:
    console.print(text, highlight=False, markup=False, soft_wrap=True)
