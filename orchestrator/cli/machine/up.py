"""`tutti up`: a complete fleet on this machine."""

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, INTERRUPTED
from orchestrator.cli.base.common import (
    check_endpoint_option,
    console,
    json_option,
    keys_folder_option,
    print_result,
)
from orchestrator.cli.base.durations import DurationType
from orchestrator.cli.base.errors import errors, exit_interrupted, exit_with_error, run_main
from orchestrator.cli.base.sizes import SizeType
from orchestrator.cli.base.systems import require_linux
from orchestrator.cli.files.fleet import require_quick_maps
from orchestrator.cli.records.folder import metrics_option
from orchestrator.clock.signals import call_at_signals

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet
    from orchestrator.runtime.live.fleet import LiveFleet
    from orchestrator.runtime.live.run import WebOptions

REACH_S = 3.0  # for controllers to be reached before `up` says which are not
POLL_S = 0.1
LAST_LINES = 5  # of the log, shown if a detached start fails

NO_REALTIME_WARNING = (
    "this user has no permission for real-time processes, so stops and starts may be late when the "
    "machine is busy; grant CAP_SYS_NICE, or an rtprio limit of 4 (`LimitRTPRIO=4` in a systemd unit)"
)


@click.command(
    epilog="""\b
Examples:
  tutti up lab.fleet.yaml --sim
  tutti up lab.fleet.yaml --detach --wait && tutti submit scan.job.yaml
  tutti up lab.fleet.yaml --connect tcp/192.168.1.5:7447

\b
Exit codes: 0 ended by Ctrl-C, SIGTERM or `tutti down`; 130 the same before the
fleet was up; 1 a part could not be started, or ended for good; 2 bad input;
3 no router at --connect. With --detach: 0 it is up."""
)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--sim", "simulated", is_flag=True, help="Replace every link by a simulated controller; print which.")
@click.option(
    "--connect",
    default="",
    callback=check_endpoint_option,
    help="Use the router (zenohd) at `tcp/HOST:PORT` instead of starting one.",
)
@click.option(
    "--port",
    default=7447,
    show_default=True,
    type=click.IntRange(1, 65_535),
    help="Port of the router that is started, on 127.0.0.1.",
)
@click.option(
    "--private", is_flag=True, help="The router listens at a socket that no other user of this computer reaches."
)
@keys_folder_option("With --connect tls/…: the folder of the fleet's keys. Each process has the identity of its role.")
@click.option("--state", type=click.Path(path_type=Path), default=None, help="Folder for journal, latches and logs.")
@click.option(
    "--host",
    "hosts",
    multiple=True,
    metavar="NAME",
    help="Run only this adapter host here (repeatable); others run with `tutti host`. Default: all.",
)
@click.option("--no-hosts", is_flag=True, help="Run no adapter host here.")
@click.option("--take-over", is_flag=True, help="Lead the fleet although another coordinator does.")
@click.option("--standby", is_flag=True, help="A second coordinator takes over within 2 s when one dies or hangs.")
@click.option("--new-journal", is_flag=True, help="Begin a journal although the one of this fleet is missing.")
@click.option("--truth", is_flag=True, help="Simulators record true motions, with times, in STATE/truth.")
@click.option("--no-record", is_flag=True, help="Do not record the fleet; else recordings go to STATE/recordings.")
@click.option(
    "--record-quota",
    default="2GB",
    show_default=True,
    type=SizeType(),
    help="Space for recordings; the oldest are deleted first.",
)
@metrics_option
@click.option("--no-web", is_flag=True, help="Serve no page.")
@click.option(
    "--web-port",
    type=click.IntRange(1, 65_535),
    default=None,
    help="Port of the operators' page; default: the first free one of 8080 to 8089.",
)
@click.option(
    "--web-host",
    default="127.0.0.1",
    show_default=True,
    help="Address of the page. Beyond this machine, e.g. 0.0.0.0, only by TLS and with users.",
)
@click.option(
    "--web-cert",
    nargs=2,
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=None,
    metavar="CERT KEY",
    help="Serve the page by TLS, with a certificate and its key (PEM files). Default beyond this machine: that of "
    "the gateway in --keys.",
)
@click.option(
    "--jobs",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    default=None,
    help="Folder of the job files that the page offers; default: that of FILE.",
)
@click.option("--wait", is_flag=True, help="It is up only when every controller is reached; see --limit.")
@click.option(
    "--limit",
    "limit_s",
    default="60s",
    show_default=True,
    type=DurationType("1h"),
    help="With --wait: fail if a controller is not reached within this time.",
)
@click.option("--detach", is_flag=True, help="Return when it is up; `tutti down` ends it. Its lines go to a log.")
@json_option
def up(
    file: Path,
    connect: str,
    port: int,
    state: Path | None,
    limit_s: float,
    hosts: tuple[str, ...],
    keys: Path | None,
    *,
    no_hosts: bool,
    private: bool,
    simulated: bool,
    take_over: bool,
    standby: bool,
    new_journal: bool,
    truth: bool,
    no_record: bool,
    record_quota: int,
    metrics_port: int | None,
    no_web: bool,
    web_port: int | None,
    web_host: str,
    web_cert: tuple[Path, Path] | None,
    jobs: Path | None,
    wait: bool,
    detach: bool,
    as_json: bool,
) -> None:
    """Start router, adapter hosts, coordinator (and simulators) for the fleet in FILE. Ctrl-C ends them all.

    Ctrl-C stops the running job first; a process that dies is restarted. Controllers that are not reached yet are
    named; they are taken in whenever they answer.
    """
    require_linux("a fleet")
    from orchestrator.runtime.live.fleet import LiveFleet
    from orchestrator.runtime.live.run import FleetRun, WebOptions
    from orchestrator.runtime.state.folder import default_state

    if private and connect:
        raise click.UsageError("--private is for the router that is started; with --connect there is none")
    wish = FleetRun(
        connect=connect,
        port=port,
        simulated=simulated,
        take_over=take_over,
        truth=truth,
        standby=standby,
        new_journal=new_journal,
        record_quota=None if no_record else record_quota,
        metrics_port=metrics_port,
        web=None if no_web else WebOptions(web_host, web_port, web_cert, jobs or file.parent),
        hosts=frozenset(hosts) if hosts or no_hosts else None,
        private=private,
        keys=keys,
    )

    def print_line(line: str) -> None:
        (errors if as_json else console).print(line, highlight=False, markup=False, soft_wrap=True)

    async def run_fleet() -> None:
        fleet = _load_fleet(file, hosts)
        folder = state or default_state(fleet.fleet)
        routers = connect or _find_routers(fleet, file)
        run = replace(
            wish,
            connect=routers,
            record_quota=_check_quota(wish.record_quota, print_line),
            keys=keys if "tls/" in routers else None,
        )
        _take_identity(run.keys)
        run = replace(run, web=_choose_web(wish.web, keys, folder, print_line))
        live = LiveFleet(fleet, folder, print_line, run)
        await _run_until_ended(live, print_line, limit_s if wait else REACH_S, required=wait, as_json=as_json)

    if not detach:
        run_main(run_fleet())
        return
    fleet = _load_fleet(file, hosts)
    options = [*wish.list_options(), "--limit", f"{limit_s}s", *(["--wait"] if wait else [])]
    _start_detached(file, state or default_state(fleet.fleet), options, as_json=as_json)


def _load_fleet(file: Path, hosts: Sequence[str]) -> "Fleet":
    """The checked fleet. A host that it does not have ends the command. Raises `FileError`."""
    from orchestrator.runtime.checked import load_checked_fleet

    fleet = load_checked_fleet(file, tolerant=True)
    require_quick_maps(fleet, file)
    unknown = [host for host in hosts if host not in fleet.hosts]
    if unknown:
        text = f"{file}: no controller has `host: {unknown[0]}`; its hosts: {', '.join(fleet.hosts)}"
        exit_with_error(text, BAD_INPUT, "correct --host", code="no-host")
    return fleet


def _find_routers(fleet: "Fleet", file: Path) -> str:
    """The routers that the fleet file names, in the form of --connect; "" without. A wrong one ends the command."""
    from orchestrator.bus.endpoint import BadEndpoint, check_endpoint

    try:
        return check_endpoint(",".join(fleet.routers)) if fleet.routers else ""
    except BadEndpoint as error:
        exit_with_error(f"{file}: routers: {error}", BAD_INPUT, code="bad-file")


def _take_identity(keys: Path | None) -> None:
    """This process looks at the bus as a coordinator: it makes sure that no other one leads."""
    from orchestrator.bus.identity import VARIABLE
    from orchestrator.keys.places import find_identity_folder

    if keys is not None and VARIABLE not in os.environ:
        os.environ[VARIABLE] = str(find_identity_folder(keys, "coordinator").absolute())


def _check_quota(quota: int | None, print_line: Callable[[str], None]) -> int | None:
    """The quota of the recorder; None if nothing can be recorded, which is printed, or nothing is to be."""
    from orchestrator.cli.base.extras import find_missing

    missing_extra = None if quota is None else find_missing("record")
    if missing_extra is not None:
        print_line(f"nothing is recorded: {'; '.join(missing_extra)}")
    return quota if missing_extra is None else None


def _choose_web(
    web: "WebOptions | None", keys: Path | None, state: Path, print_line: Callable[[str], None]
) -> "WebOptions | None":
    """The page as it was wanted, for other computers with the gateway's certificate in `keys` unless another one was
    given; None if it cannot be served, which is said. Raises `Refusal` where other computers must not reach it."""
    from orchestrator.cli.base.extras import find_missing

    if web is None:
        return None
    missing_extra = find_missing("web")
    if missing_extra is not None:
        print_line(f"no page: {'; '.join(missing_extra)}")
        return None
    from orchestrator.gateway.access.users import UserFile
    from orchestrator.gateway.certificate import read_web_certificate
    from orchestrator.gateway.reach import is_own_address, require_reach
    from orchestrator.runtime.state.folder import USERS_FILE

    if is_own_address(web.host):
        return web
    files = web.certificate or (None if keys is None else _find_gateway_files(keys))
    certificate = None if files is None else read_web_certificate(*files)
    require_reach(web.host, certificate, UserFile(state / USERS_FILE), datetime.now(UTC))
    return replace(web, certificate=files)


def _find_gateway_files(keys: Path) -> tuple[Path, Path]:
    """The certificate of the fleet's gateway, and its key. Raises `Refusal`."""
    from orchestrator.bus.identity import CERTIFICATE_FILE, KEY_FILE
    from orchestrator.keys.places import find_identity_folder

    folder = find_identity_folder(keys, "gateway").absolute()
    return folder / CERTIFICATE_FILE, folder / KEY_FILE


async def _run_until_ended(
    live: "LiveFleet", print_line: Callable[[str], None], limit_s: float, *, required: bool, as_json: bool
) -> None:
    """Start the fleet, say that it is up, and run it until it is to end, or a part of it has ended for good."""
    from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority

    end = asyncio.Event()
    loop = asyncio.get_running_loop()
    call_at_signals(end.set)
    if not set_realtime_priority(RealtimePriority.SERVICE, children=False):
        print_line(NO_REALTIME_WARNING)
    starting = loop.create_task(_start_and_reach(live, limit_s, required=required))
    ended_task = loop.create_task(end.wait())
    await asyncio.wait([starting, ended_task], return_when=asyncio.FIRST_COMPLETED)
    if not starting.done():
        print_line("interrupted while starting; ending the started processes")
        starting.cancel()
        await asyncio.wait([starting])
        raise SystemExit(INTERRUPTED)
    missing_names, name = await starting, live.fleet.fleet
    value = {"fleet": name, "connect": live.connect, "state": str(live.state), "page": live.page or None}
    absent = f"; {', '.join(missing_names)} not reached yet" if missing_names else ""
    page = f"; page on {live.page}" if live.page else ""
    words = f"fleet {name} is up{absent}{page}; state in {live.state}; Ctrl-C ends it"
    print_result({**value, "not_reached": missing_names}, words, as_json=as_json)
    assert live.failed is not None
    await asyncio.wait([ended_task, live.failed], return_when=asyncio.FIRST_COMPLETED)
    print_line("stopping")
    await live.close()
    if live.failed.done():
        raise SystemExit(FAILED)


async def _start_and_reach(live: "LiveFleet", limit_s: float, *, required: bool) -> list[str]:
    """Start the fleet, and wait until its controllers are reached; return those that are not at the end of the limit.

    required: then end the fleet again. Raises `UpFailed`.
    """
    from orchestrator.client import Tutti
    from orchestrator.runtime.state.folder import UpFailed

    await live.start()
    missing_names = dict.fromkeys(live.fleet.controllers, "no adapter answers")
    try:
        async with asyncio.timeout(limit_s), Tutti(live.connect, live.fleet.fleet, actor="up") as tutti:
            while missing_names:
                for name, state in (await tutti.status(limit_s)).items():
                    fault = next((f"{report.text}; {report.remedy}" for report in state.faults), state.mode)
                    missing_names[name] = fault if state.mode == "offline" else ""
                missing_names = {
                    name: reason for name, reason in missing_names.items() if reason and name in live.fleet.controllers
                }
                await asyncio.sleep(POLL_S)
    except TimeoutError:
        pass
    except BaseException:
        await live.close()
        raise
    if missing_names and required:
        await live.close()
        reasons = "; ".join(f"{name}: {reason}" for name, reason in missing_names.items())
        raise UpFailed(f"not reached within {limit_s:g} s: {reasons}")
    return list(missing_names)


def _start_detached(file: Path, folder: Path, options: Sequence[str], *, as_json: bool) -> None:
    """Start `tutti up` in a session of its own, and return when it is up, or exit with its error."""
    from orchestrator.bus.logfile import rotate_if_large
    from orchestrator.model.files.private_files import open_for_append
    from orchestrator.runtime.state.folder import UP_LOG

    log = folder / "log" / UP_LOG
    rotate_if_large(log)
    code = "from orchestrator.cli.main import main; main(prog_name='tutti')"
    command = [sys.executable, "-P", "-c", code, "up", str(file), "--json", "--state", str(folder), *options]
    with os.fdopen(open_for_append(log), "ab") as lines:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=lines, start_new_session=True
        )
    try:
        value = _read_document(process)
    except KeyboardInterrupt:
        process.terminate()
        process.wait()
        exit_interrupted()
    if process.poll() is not None or "fleet" not in value:
        _exit_with_start_error(value, process.wait(), log)
    value |= {"pid": process.pid, "log": str(log)}
    missing_names = value["not_reached"]
    absent = f"; {', '.join(missing_names)} not reached yet" if missing_names else ""
    page = f"; page on {value['page']}" if value.get("page") else ""
    words = f"fleet {value['fleet']} is up{absent}{page}; state in {folder}; lines in {log}; `tutti down` ends it"
    print_result(value, words, as_json=as_json)


def _read_document(process: "subprocess.Popen[bytes]") -> dict[str, Any]:
    """The object that the process prints first; empty if it ends without one."""
    assert process.stdout is not None
    lines: list[bytes] = []
    for line in process.stdout:
        lines.append(line)
        if line.rstrip() == b"}":
            return json.loads(b"".join(lines))
    return {}


def _exit_with_start_error(error: dict[str, Any], code: int, log: Path) -> NoReturn:
    if "text" in error:
        exit_with_error(error["text"], code, error["remedy"], code=error["code"])
    last = log.read_text(encoding="utf-8", errors="replace").splitlines()[-LAST_LINES:]
    exit_with_error(f"it ended with exit code {code}: {' / '.join(last)}", FAILED, f"see {log}")
