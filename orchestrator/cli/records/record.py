"""`tutti record …`: record a fleet, list recordings, repair them."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, UNREACHABLE
from orchestrator.cli.base.common import (
    connect_option,
    console,
    fleet_option,
    json_option,
    print_json,
    utc_option,
)
from orchestrator.cli.base.errors import errors, exit_with_error
from orchestrator.cli.base.extras import require_extra
from orchestrator.cli.base.sizes import SizeType, format_size
from orchestrator.cli.records.folder import (
    find_folder,
    folder_option,
    metrics_option,
    recorded_fleet_option,
)

if TYPE_CHECKING:
    from orchestrator.monitor.recording.reader import RecordingSummary


@click.group(epilog="Example: tutti record ls")
def record() -> None:
    """Recordings of everything that a fleet publishes, as MCAP files: one for each job, others for the rest.

    `tutti up` records by itself, into the folder `recordings` of its state folder.
    """


@record.command(epilog="Example: tutti record start --fleet lab --connect tcp/192.168.1.5:7447 --folder /data/lab")
@connect_option
@fleet_option("The fleet.", required=True)
@click.option("--folder", type=click.Path(path_type=Path), required=True, help="Where the recordings go.")
@click.option("--quota", default="2GB", show_default=True, type=SizeType(), help="Space for all recordings there.")
@click.option(
    "--fleet-file", type=click.Path(path_type=Path, exists=True), default=None, help="Attached to every recording."
)
@metrics_option
def start(
    connect: str, fleet: str, folder: Path, quota: int, fleet_file: Path | None, metrics_port: int | None
) -> None:
    """Record a fleet until Ctrl-C, also from another machine. It only listens, and never slows motion down.

    The oldest recordings are deleted when the quota is used up, never that of a running job.
    """
    require_extra("record")
    import asyncio

    from orchestrator.bus.zenoh.sessions import RouterUnreachable
    from orchestrator.monitor.recording.lock import FolderInUse
    from orchestrator.monitor.recording.process import RecorderOptions, record_fleet

    def print_ready(metrics: str) -> None:
        with_metrics = f"; {metrics}" if metrics else ""
        console.print(
            f"records fleet {fleet} in {folder}{with_metrics}; Ctrl-C ends it", highlight=False, soft_wrap=True
        )

    options = RecorderOptions(
        fleet=fleet,
        connect=connect,
        folder=folder,
        quota=quota,
        log=folder / "recorder.jsonl",
        fleet_file=fleet_file,
        metrics_port=metrics_port,
    )
    try:
        asyncio.run(record_fleet(options, print_ready))
    except FolderInUse as error:
        exit_with_error(str(error), BAD_INPUT)
    except RouterUnreachable as error:
        exit_with_error(str(error), UNREACHABLE)
    except OSError as error:
        exit_with_error(f"{getattr(error, 'filename', None) or folder}: {error.strerror}", BAD_INPUT)


@record.command("ls", epilog="Example: tutti record ls --limit 5")
@folder_option
@recorded_fleet_option
@click.option("--limit", default=20, show_default=True, type=click.IntRange(1, 100_000), help="The newest ones.")
@utc_option
@json_option
def list_files(folder: Path | None, fleet: str | None, limit: int, *, as_json: bool) -> None:
    """List recordings, the newest first."""
    require_extra("record")
    from orchestrator.monitor.recording.lock import is_locked
    from orchestrator.monitor.recording.reader import list_recordings

    recording_folder = find_folder(folder, fleet)
    recordings = list(reversed(list_recordings(recording_folder)))
    is_open = is_locked(recording_folder)
    if as_json:
        print_json([_to_plain(summary, written=is_open) for summary in recordings[:limit]])
        return
    _print_table(recordings[:limit], written=is_open)
    total = sum(summary.size for summary in recordings)
    more = f", {limit} of them shown" if len(recordings) > limit else ""
    console.print(
        f"{len(recordings)} recordings, {format_size(total)}, in {recording_folder}{more}",
        highlight=False,
        soft_wrap=True,
    )


@record.command(epilog="Example: tutti record repair lab/recordings/job-20261125T101500Z-scan-3f2a8c01.mcap")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@json_option
def repair(files: tuple[Path, ...], *, as_json: bool) -> None:
    """Repair recordings that were not closed, e.g. after a power cut: what is whole is kept, and gets an index.

    A file with damage in its middle is kept beside the repaired one, as FILE.damaged.
    """
    require_extra("record")
    from orchestrator.monitor.recording.repair import RepairFailed, repair_recording

    results: list[dict[str, Any]] = []
    has_failed = False
    for path in files:
        try:
            result = repair_recording(path)
        except (RepairFailed, OSError) as error:
            has_failed = True
            text = str(error) if isinstance(error, RepairFailed) else f"{path}: {error.strerror}"
            results.append({"file": str(path), "error": text})
            if not as_json:
                errors.print(f"[bold red]tutti:[/] {text}", highlight=False, soft_wrap=True)
            continue
        original = None if result.original is None else str(result.original)
        results.append(
            {"file": str(path), "messages": result.messages, "lost_bytes": result.lost_bytes, "original": original}
        )
        if not as_json:
            words = f"{path}: {result.messages} messages"
            words += f"; {result.reason}, {result.lost_bytes} bytes left out" if result.reason else ", it is whole"
            console.print(words + (f"; as it was: {original}" if original else ""), highlight=False, soft_wrap=True)
    if as_json:
        print_json(results)
    if has_failed:
        raise SystemExit(FAILED)


def _to_plain(found: "RecordingSummary", *, written: bool) -> dict[str, Any]:
    return {
        "file": str(found.path),
        "kind": found.description.get("kind", ""),
        "fleet": found.fleet,
        "job_id": found.job_id,
        "job_name": found.job_name,
        "size": found.size,
        "messages": found.messages,
        "begins": _format_ns(found.begins_ns),
        "ends": _format_ns(found.ends_ns),
        "state": _describe_state(found, written=written),
    }


def _describe_state(found: "RecordingSummary", *, written: bool) -> str:
    if found.is_complete:
        return "complete"
    return "being written" if written else "needs repair"


def _format_ns(at_ns: int | None) -> str | None:
    from orchestrator.clock.utc import format_utc_ns

    return None if at_ns is None else format_utc_ns(at_ns)


def _print_table(found: "list[RecordingSummary]", *, written: bool) -> None:
    from orchestrator.monitor.tables import PlainTable
    from orchestrator.monitor.times import format_time

    table = PlainTable(["begins", "s>", "job", "id", "messages>", "size>", "state", "file"], ["job", "file"])
    for summary in found:
        begins, ends = summary.begins_ns, summary.ends_ns
        duration = "" if begins is None or ends is None else f"{(ends - begins) / 1e9:.1f}"
        table.add_row(
            format_time(_format_ns(begins) or ""),
            duration,
            summary.job_name or "(fleet)",
            summary.job_id[:8],
            "" if summary.messages is None else str(summary.messages),
            format_size(summary.size),
            _describe_state(summary, written=written),
            summary.path.name,
        )
    console.print(table)
