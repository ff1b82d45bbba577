"""`tutti trace`: the bytes on one controller's link, in words."""

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.completion import complete_controllers
from orchestrator.cli.base.durations import DurationType

if TYPE_CHECKING:
    from rich.text import Text

    from adapters.link.can_log import LogFormat
    from orchestrator.client import Tutti
    from orchestrator.link.trace import TraceEntry
    from orchestrator.model.messages import TraceReply
    from orchestrator.runtime.trace_frames import FrameList, ShownFrame

FOLLOW_S = 0.5  # between two requests
TEXT_COLUMNS = 34  # after which meanings stand


@click.command(
    epilog="""\b
Examples:
  tutti trace gantry --last 5s
  tutti trace stage --follow
  tutti trace spindle --format blf --output spindle.blf"""
)
@click.argument("controller", shell_complete=complete_controllers)
@click.option("--last", type=DurationType("60s"), default=None, help="Only this last time, e.g. 5s.")
@click.option("--follow", is_flag=True, help="Continue with new frames until Ctrl-C.")
@click.option("--raw", is_flag=True, help="Bytes as they were written and read, without decoding.")
@click.option("--format", "form", type=click.Choice(["asc", "blf", "candump"]), help="Format of a CAN bus log.")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), help="Output file of the log.")
@fleet_options
@json_option
def trace(
    controller: str,
    last: float | None,
    form: "LogFormat | None",
    output: Path | None,
    connect: str,
    fleet: str | None,
    *,
    follow: bool,
    raw: bool,
    as_json: bool,
) -> None:
    """Show the frames of the last 60 s on CONTROLLER's link: time, direction, text, meaning.

    Frames of other controllers on the same line are shown too, with the address of each. With --format and --output,
    write the frames of its CAN bus to a log file for other tools.
    """
    if (form is None) != (output is None):
        raise click.UsageError("--format and --output must be given together")
    if form is not None and follow:
        raise click.UsageError("--follow cannot be given with --format")

    async def show_trace(tutti: "Tutti") -> None:
        reply = await tutti.read_trace(controller, last_s=last)
        if form is not None and output is not None:
            count = _write_log(reply, form, output, controller)
            print_json({"frames": count, "file": str(output)}) if as_json else console.print(
                f"{count} frames in {output}", highlight=False, markup=False
            )
            return
        from orchestrator.runtime.trace_frames import FrameList

        reader = FrameList(reply, raw=raw)
        if not follow and as_json:
            print_json({**reply.to_plain(), "frames": [frame._asdict() for frame in reader.read_frames(reply)]})
            return
        if not as_json:
            console.print(reader.describe_origin(), highlight=False)
        _print_frames(reader, reply, as_json=as_json)
        while follow:
            await asyncio.sleep(FOLLOW_S)
            reply = await tutti.read_trace(controller, after=reply.newest)
            _print_frames(reader, reply, as_json=as_json)

    with_fleet(connect, fleet, show_trace)


def _print_frames(reader: "FrameList", reply: "TraceReply", *, as_json: bool) -> None:
    if reply.lost and not as_json:
        console.print(f"{reply.lost} entries are lost: more than the adapter keeps", style="yellow", highlight=False)
    for frame in reader.read_frames(reply):
        if as_json:
            console.out(json.dumps(frame._asdict()), highlight=False)
        else:
            console.print(_format_frame(frame), soft_wrap=True)


def _format_frame(frame: "ShownFrame") -> "Text":
    from rich.text import Text

    arrow = "→" if frame.direction == "out" else "←"
    address = f"[{frame.address}] " if frame.address else ""
    line = Text(f"{frame.after_s:+11.6f} s {arrow} ")
    if not frame.meaning:
        return line.append(f"{address}{frame.text}")
    return line.append(f"{address}{frame.text}".ljust(TEXT_COLUMNS)).append(f"  {frame.meaning}", style="dim")


def _write_log(reply: "TraceReply", form: "LogFormat", output: Path, controller: str) -> int:
    """Write the log and return the number of frames. Raises `click.ClickException`."""
    from datetime import datetime

    from adapters.link.can_log import write_log

    entries: list[TraceEntry] = [(at_ns, direction, text.encode("latin-1")) for at_ns, direction, text in reply.entries]
    origin_s = datetime.fromisoformat(reply.utc).timestamp() - reply.host_ns / 1e9
    try:
        return write_log(output, form, entries, origin_s)
    except ValueError as error:
        raise click.ClickException(f"{controller} is not on a CAN bus: {error}; trace it without --format") from None
    except OSError as error:
        raise click.ClickException(f"{output}: {error.strerror}; choose another file: --output") from None
