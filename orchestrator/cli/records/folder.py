"""Which folder of recordings a command means."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import fleet_option
from orchestrator.cli.base.errors import exit_with_error

if TYPE_CHECKING:
    from orchestrator.monitor.recording.reader import RecordingSummary

folder_option = click.option(
    "--folder",
    type=click.Path(path_type=Path),
    default=None,
    help="The folder of the recordings. Else that of the fleet's state folder.",
)
recorded_fleet_option = fleet_option("The fleet, if several have run here.")
metrics_option = click.option(
    "--metrics-port",
    type=click.IntRange(0, 65_535),
    default=None,
    help="Port of the metrics for Prometheus, on 127.0.0.1; 0: none. Default: the first free one of 9464 to 9473.",
)


def find_folder(folder: Path | None, fleet: str | None) -> Path:
    """The folder that is meant; without an answer the command ends."""
    from orchestrator.runtime.state.folder import RECORDINGS, default_state, find_running_fleets

    if folder is not None:
        if not folder.is_dir():
            exit_with_error(f"{folder} is no folder", BAD_INPUT, "give the folder of the recordings")
        return folder
    root = default_state("any").parent
    paths = {path.parent.name: path for path in sorted(root.glob(f"*/{RECORDINGS}"))}
    paths |= {running_fleet.fleet: running_fleet.folder / RECORDINGS for running_fleet in find_running_fleets()}
    if fleet is not None:
        paths = {name: path for name, path in paths.items() if name == fleet}
    if not paths:
        title = f"no recordings of fleet {fleet}" if fleet else "no recordings"
        exit_with_error(
            f"{title} below {root}", BAD_INPUT, "with `tutti up --state FOLDER` they are in --folder FOLDER/recordings"
        )
    if len(paths) > 1:
        names = ", ".join(paths)
        exit_with_error(f"recordings of several fleets: {names}", BAD_INPUT, "choose one with --fleet or --folder")
    return next(iter(paths.values()))


def find_recording(reference: str, folder: Path | None, fleet: str | None) -> "RecordingSummary":
    """The recording that is meant: a file, or a job by its id, the beginning of it, its name, or `last`."""
    from orchestrator.monitor.recording.reader import RecordingUnreadable, list_recordings, summarize_recording

    path = Path(reference)
    if path.suffix == ".mcap" or path.is_file():
        try:
            return summarize_recording(path)
        except RecordingUnreadable as error:
            exit_with_error(str(error), BAD_INPUT, "give a file that `tutti record` has written")
        except OSError as error:
            exit_with_error(f"{path}: {error.strerror}", BAD_INPUT)
    recording_folder = find_folder(folder, fleet)
    jobs = [recording for recording in list_recordings(recording_folder) if recording.job_id]
    named_jobs = jobs[-1:] if reference == "last" else [job for job in jobs if job.job_id.startswith(reference)]
    named_jobs = named_jobs or [job for job in jobs if job.job_name == reference][-1:]
    if not named_jobs:
        exit_with_error(f"no recording of job {reference!r} in {recording_folder}", BAD_INPUT, "see `tutti record ls`")
    if len(named_jobs) > 1:
        text = ", ".join(summary.job_id[:12] for summary in named_jobs)
        exit_with_error(f"{reference!r} stands for several jobs: {text}", BAD_INPUT, "write more of the id")
    return named_jobs[0]
