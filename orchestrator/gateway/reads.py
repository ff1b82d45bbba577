"""Answers to GET: what the fleet, its journal and its recordings have."""

import io
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from starlette.responses import JSONResponse, Response

from orchestrator.client import Tutti
from orchestrator.client.clocks import query_clocks
from orchestrator.clock.executor import Executor
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.commands import FleetCommands
from orchestrator.gateway.job_files import JobFiles
from orchestrator.gateway.job_plot import draw_job_steps, draw_step, find_plotted_steps, list_samples
from orchestrator.gateway.lists import list_controllers, make_cursor, read_cursor
from orchestrator.gateway.openapi import make_openapi
from orchestrator.gateway.preview import draw_path
from orchestrator.gateway.replies import make_model_response
from orchestrator.gateway.stream.hub import StreamHub
from orchestrator.gateway.stream.need import read_need
from orchestrator.model.errors import Refusal
from orchestrator.model.positions.resolve import PositionResolver
from orchestrator.model.queue import format_utc, shift_utc
from orchestrator.model.report import QueueState, StepRecording
from orchestrator.model.steps.numbers import name_step
from orchestrator.model.steps.order import StepOrder
from orchestrator.model.steps.tree import iterate_steps
from orchestrator.model.templates.file_schema import make_job_file_schema
from orchestrator.model.templates.fleet_schema import make_fleet_file_schema
from orchestrator.monitor.export.csv_table import CsvTable
from orchestrator.plan.forecast.present import look_at_axes
from orchestrator.runtime.trace_frames import FrameList

MAX_RECORDINGS = 1000
MAX_TRACE_FRAMES = 2000
STATISTICS_S = 30 * 24 * 3600  # unless a day is given
RECORDED = ".mcap"

Values = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class ReadRequest:
    """A GET: values from its path and its query together."""

    identity: Identity
    values: Values

    def read_int(self, name: str, default: int) -> int:
        """An integer of the query. Raises `Refusal`."""
        text = self.values.get(name, "")
        if not text:
            return default
        if not text.isdecimal() or len(text) > 15:
            raise Refusal("bad-request", f"{name}={text[:40]} is no number", f"for example {name}={default}")
        return int(text)


Reader = Callable[[ReadRequest], Awaitable[Response]]


class FleetReads:
    """The readers by their paths. recordings: the folder of recordings; None: not on this machine."""

    def __init__(
        self, commands: FleetCommands, hub: StreamHub, files: JobFiles, recordings: Path | None, execute: Executor
    ) -> None:
        self._commands, self._hub, self._files = commands, hub, files
        self._recordings, self._execute = recordings, execute
        self.readers: Mapping[str, Reader] = {
            "/v1/state": self._read_state,
            "/v1/controllers": self._list_controllers,
            "/v1/queue": self._read_queue,
            "/v1/jobs": self._list_jobs,
            "/v1/jobs/{job_id}": self._show_job,
            "/v1/jobs/{job_id}/plan": self._read_plan,
            "/v1/jobs/{job_id}/axes": self._list_axes,
            "/v1/jobs/{job_id}/points": self._read_points,
            "/v1/jobs/{job_id}/recording/{step}": self._read_recording,
            "/v1/jobs/{job_id}/plot": self._plot_job,
            "/v1/jobs/{job_id}/path/{step}": self._read_path,
            "/v1/jobs/{job_id}/export.csv": self._export_job,
            "/v1/alarms": self._list_alarms,
            "/v1/names": self._list_names,
            "/v1/virtual": self._list_virtual,
            "/v1/zones": self._read_zones,
            "/v1/positions": self._list_positions,
            "/v1/statistics": self._read_statistics,
            "/v1/recordings": self._list_recordings,
            "/v1/commands": self._list_commands,
            "/v1/fleet": self._read_fleet,
            "/v1/clocks": self._read_clocks,
            "/v1/trace/{controller}": self._read_trace,
            "/v1/templates": self._list_templates,
            "/v1/schemas/{kind}": self._read_schema,
            "/v1/openapi.json": self._read_openapi,
        }

    def _connect(self, request: ReadRequest) -> Tutti:
        return self._commands.connect(request.identity)

    async def _ask(self, request: ReadRequest, verb: str, **fields: Any) -> Response:
        return make_model_response(await self._commands.request(request.identity, verb, fields))

    # Now

    async def _read_state(self, _: ReadRequest) -> Response:
        return JSONResponse(self._hub.state.compose())

    async def _read_queue(self, _: ReadRequest) -> Response:
        return JSONResponse(self._hub.state.compose(read_need(["queue"])).get("queue", {}))

    async def _list_controllers(self, request: ReadRequest) -> Response:
        name, mode, cursor = (request.values.get(field, "") for field in ("name", "mode", "cursor"))
        limit, last_name = request.read_int("limit", 100), read_cursor("/v1/controllers", cursor)
        return JSONResponse(list_controllers(self._hub.state, name, mode, limit, last_name))

    async def _list_alarms(self, request: ReadRequest) -> Response:
        every = request.values.get("all", "") not in ("", "0", "false")
        return await self._ask(request, "alarms", all=every, history=request.read_int("history", 0))

    async def _list_names(self, request: ReadRequest) -> Response:
        return await self._ask(request, "names")

    async def _list_virtual(self, request: ReadRequest) -> Response:
        return await self._ask(request, "virtual")

    async def _read_zones(self, request: ReadRequest) -> Response:
        return await self._ask(request, "zones")

    async def _list_positions(self, request: ReadRequest) -> Response:
        return await self._ask(request, "positions")

    # Jobs

    async def _list_jobs(self, request: ReadRequest) -> Response:
        given_values = {name: request.values[name] for name in ("state", "name", "since") if request.values.get(name)}
        last_id = read_cursor("/v1/jobs", request.values.get("cursor", ""))
        fields = {**given_values, "limit": request.read_int("limit", 50), "before": last_id}
        jobs = await self._commands.request(request.identity, "list", fields)
        if not isinstance(jobs, QueueState) or jobs.total <= len(jobs.jobs):
            return make_model_response(jobs)
        return JSONResponse({**jobs.to_plain(), "next": make_cursor("/v1/jobs", jobs.jobs[-1].id)})

    async def _show_job(self, request: ReadRequest) -> Response:
        return await self._ask(request, "show", job_id=request.values["job_id"])

    async def _read_points(self, request: ReadRequest) -> Response:
        cursor = {"after_point": request.read_int("after", 0), "limit": request.read_int("limit", 1000)}
        if request.values.get("step"):
            cursor["after_step"] = request.read_int("step", 0)
        return await self._ask(request, "points", job_id=request.values["job_id"], **cursor)

    async def _read_plan(self, request: ReadRequest) -> Response:
        """What a queued job will do now, and its plan for approval."""
        tutti, job_id = self._connect(request), request.values["job_id"]
        planned_job = await tutti.plan_job(job_id)
        shown_job = await tutti.show_job(job_id)
        if shown_job.job is None:
            return make_model_response(planned_job)
        return await self._files.show_job(tutti, shown_job.job, planned_job.to_plain())

    async def _list_axes(self, request: ReadRequest) -> Response:
        """The axes that the rest of a job uses, those of its named positions too."""
        tutti, job_id = self._connect(request), request.values["job_id"]
        shown_job = await tutti.show_job(job_id)
        if shown_job.job is None or shown_job.entry is None:
            raise Refusal("no-file", f"the steps of job {job_id} are not kept", "")
        fleet = await tutti.load_fleet()
        resolver = PositionResolver(fleet, await tutti.list_positions())
        begin, repeat = shown_job.entry.from_step, shown_job.entry.terms.repeat
        order = resolver.resolve_remaining(shown_job.job.steps, repeat, begin)
        steps = iterate_steps(part.step for part in order.list_remaining(begin))
        return JSONResponse({"axes": list(dict.fromkeys(axis for step in steps for axis in step.find_axes(fleet)))})

    async def _load_recording(self, request: ReadRequest, step: int) -> StepRecording:
        recording = await self._connect(request).load_recording(request.values["job_id"], step)
        if recording is None:
            text = f"{name_step(step)} (`step={step}`) has no recording: it moved nothing, or its recording was deleted"
            raise Refusal("no-file", text, "choose another step; see /v1/jobs/{job_id}")
        return recording

    async def _read_recording(self, request: ReadRequest) -> Response:
        recording = await self._load_recording(request, request.read_int("step", 0))
        axes = await self._execute(draw_step, recording)
        return JSONResponse({"step": recording.step, "t0_fleet_ns": recording.t0_fleet_ns, "axes": axes})

    async def _plot_job(self, request: ReadRequest) -> Response:
        """All motion steps of a job that have a recording, over one time."""
        tutti, job_id = self._connect(request), request.values["job_id"]
        locations, steps_before = find_plotted_steps(await tutti.show_job(job_id))
        recordings = [(location, await tutti.load_recording(job_id, location.index)) for location in locations]
        kept_recordings = [(location, recording) for location, recording in recordings if recording is not None]
        if not kept_recordings:
            text = f"job {job_id} has no recording: it has moved nothing yet, or its recordings were deleted"
            raise Refusal("no-file", text, "recordings are kept for the newest jobs only")
        drawing = await self._execute(draw_job_steps, kept_recordings)
        return JSONResponse({**drawing, "left_out": steps_before})

    async def _read_path(self, request: ReadRequest) -> Response:
        """The planned path of a step, in a thread: a long one takes seconds."""
        tutti, index = self._connect(request), request.read_int("step", 0)
        shown_job = await tutti.show_job(request.values["job_id"])
        order = (
            None
            if shown_job.job is None or shown_job.entry is None
            else StepOrder(shown_job.job.steps, shown_job.entry.terms.repeat)
        )
        if order is None or index >= len(order):
            raise Refusal("no-file", f"there is no {name_step(index)} (`step={index}`)", "choose another step")
        fleet, positions = await tutti.load_fleet(), await tutti.list_positions()
        axes = look_at_axes(fleet, await tutti.status())
        return JSONResponse(await self._execute(draw_path, fleet, positions, axes, order.locate(index)))

    async def _export_job(self, request: ReadRequest) -> Response:
        """Polled and planned positions of all its moves that have a recording, as CSV."""
        tutti, job_id = self._connect(request), request.values["job_id"]
        report = (await tutti.show_job(job_id)).report
        if report is None:
            raise Refusal("not-ended", f"job {job_id} has not ended", "export it after its end")
        result = await tutti.load_result(report)
        text = io.StringIO()
        table = CsvTable(text, line_end="\n")
        table.write_row(["step", "axis", "unit", "fleet_ns", "after_t0_s", "planned", "actual"])
        for recording in result.recordings:
            for name, axis in recording.axes.items():
                table.write_rows(list_samples(recording, name, axis))
        headers = {"Content-Disposition": f'attachment; filename="{report.job_id}.csv"'}
        return Response(text.getvalue(), media_type="text/csv", headers=headers)

    # Service

    async def _read_statistics(self, request: ReadRequest) -> Response:
        begin_utc = request.values.get("since") or shift_utc(self._hub.clock.utc(), -STATISTICS_S)[:10]
        return await self._ask(request, "statistics", since=begin_utc)

    async def _list_recordings(self, _: ReadRequest) -> Response:
        return JSONResponse({"files": await self._execute(self._find_recordings)})

    def _find_recordings(self) -> list[dict[str, Any]]:
        recordings: list[dict[str, Any]] = []
        paths = [] if self._recordings is None else list(self._recordings.glob(f"*{RECORDED}"))
        for path in sorted(paths, key=lambda path: path.name, reverse=True)[:MAX_RECORDINGS]:
            try:
                stat = path.stat()
            except OSError:
                continue  # deleted meanwhile
            changed_utc = format_utc(datetime.fromtimestamp(stat.st_mtime, UTC))
            recordings.append({"name": path.name, "bytes": stat.st_size, "changed_utc": changed_utc})
        return recordings

    async def _list_commands(self, request: ReadRequest) -> Response:
        return await self._ask(request, "commands", limit=request.read_int("limit", 100))

    async def _read_fleet(self, request: ReadRequest) -> Response:
        fleet = await self._connect(request).load_fleet()
        states = await self._connect(request).status()
        digests = {
            name: {"file": config.digest, "running": states[name].digest if name in states else None}
            for name, config in fleet.controllers.items()
        }
        return JSONResponse({"configuration": fleet.to_plain(), "digests": digests})

    async def _read_clocks(self, request: ReadRequest) -> Response:
        clocks = await query_clocks(self._connect(request))
        plain = {name: clock.to_plain() for name, clock in clocks.items()}
        return JSONResponse({"clocks": plain, "history": self._hub.state.clock_history.show()})

    async def _read_trace(self, request: ReadRequest) -> Response:
        number = request.read_int("after", 0)
        reply = await self._connect(request).read_trace(request.values["controller"], after=number)
        frames = [
            {
                "at_s": round(frame.after_s, 6),
                "direction": frame.direction,
                "text": frame.text,
                "meaning": frame.meaning,
            }
            for frame in FrameList(reply, raw=False).read_frames(reply)
        ]
        return JSONResponse({"frames": frames[-MAX_TRACE_FRAMES:], "newest": reply.newest, "lost": reply.lost})

    async def _list_templates(self, _: ReadRequest) -> Response:
        return JSONResponse({"templates": await self._execute(self._files.list_templates)})

    async def _read_schema(self, request: ReadRequest) -> Response:
        kind = request.values["kind"]
        if kind not in ("job", "fleet"):
            raise Refusal("no-file", f"there is no schema {kind[:40]!r}; there are: fleet, job", "choose one of them")
        return JSONResponse(make_fleet_file_schema() if kind == "fleet" else make_job_file_schema())

    async def _read_openapi(self, _: ReadRequest) -> Response:
        return JSONResponse(make_openapi(list(self.readers)))
