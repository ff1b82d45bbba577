"""A scan that flies: prepared (loaded in its controllers, which wait), started, and collected while it flies.

A plan declares it as a stream: its rows are an HDF5 file, whose documents come while it is written.
"""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import AsyncExitStack, aclosing, suppress
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any, cast

from bluesky.protocols import Hints, StreamAsset
from event_model import DataKey
from ophyd_async.core import (
    ConfinedModel,
    FlyableLogic,
    PathProvider,
    StandardFlyable,
    StreamResourceDataProvider,
    WatchableAsyncStatus,
    WatcherUpdate,
    observe_value,
    soft_signal_r_and_setter,
)
from pydantic import Field
from scanspec.specs import Spec

from integrations.bluesky.axis import TuttiAxis
from integrations.bluesky.connection import TuttiConnection
from integrations.bluesky.row_file import RowFile
from tutti import Job, JobFailed, JobProgress, QueueTerms, Refusal, Scan, SubmittedJob, Tutti, WaitArmed


class FlightInfo(ConfinedModel):
    """What a flight is prepared with.

    spec: of scanspec, with `Fly` and a duration; its axes are `TuttiAxis` devices, their names, or `controller.axis`.
    trigger: `{"output": "gantry.lamp", "at": "middle"}`, as in `fly` of a job. armed_s: how long it waits for its
    kickoff.
    """

    spec: Spec[Any]
    trigger: dict[str, Any] | None = None
    armed_s: float = Field(default=600.0, gt=0)


@dataclass(eq=False)
class Flight:
    """A flight that is prepared. writing: of its rows, once it has begun."""

    context: AsyncExitStack
    job: SubmittedJob
    frames: int
    file: RowFile
    writing: "asyncio.Task[None] | None" = None


@dataclass(eq=False)
class FlightLogic(FlyableLogic[FlightInfo, Flight]):
    """Flies scans of one fleet."""

    flyer: "TuttiFlyer"
    flight: Flight | None = None

    async def on_prepare(self, value: FlightInfo) -> Flight:
        """Move to the beginning of the first line, and load its flight in all controllers. Raises `Refusal`,
        `JobFailed`, `ValueError` for a spec that does not fly."""
        await self.stop()
        connection = self.flyer.connection
        tutti = await connection.open()
        scan, axes = make_scan(value)
        steps = [WaitArmed(timeout=f"{value.armed_s:.9f} s"), scan]
        await connection.moves.release(axes)
        async with AsyncExitStack() as context:
            attendance = await context.enter_async_context(tutti.attend())
            job = await tutti.submit(
                Job(self.flyer.name or "flight", steps), terms=QueueTerms(session=attendance.session, now=True)
            )
            context.push_async_callback(cancel_job, job)
            await wait_until_armed(job)
            await connection.reader.wait_for_first(tutti, axes[0])
            file = self.flyer.open_file(axes)
            context.callback(file.close)
            frames = prod(value.spec.shape())
            self.flight = Flight(context.pop_all(), job, frames, file)
        return self.flight

    async def on_kickoff(self, ctx: Flight) -> Flight:
        """Start the flight; return when its start is agreed. Raises `Refusal`."""
        await ctx.job.go()
        tutti = await self.flyer.connection.open()
        ctx.writing = asyncio.get_running_loop().create_task(self._write_rows(tutti, ctx))
        return ctx

    async def on_complete(self, ctx: Flight) -> None:
        """Wait until it is flown and its rows are written. Raises `JobFailed`."""
        assert ctx.writing is not None
        try:
            await asyncio.shield(ctx.writing)
            report = await ctx.job.result()
            if report.state != "done":
                raise JobFailed(report)
        finally:
            await self.stop()

    async def stop(self) -> None:
        """Stop what flies, and close the file of rows."""
        flight, self.flight = self.flight, None
        if flight is None:
            return
        await flight.context.aclose()
        if flight.writing is not None:
            flight.writing.cancel()

    async def _write_rows(self, tutti: Tutti, flight: Flight) -> None:
        async with aclosing(tutti.follow_point_batches(flight.job)) as batches:
            async for records in batches:
                await asyncio.to_thread(flight.file.add_rows, records)
                self.flyer.set_written(flight.file.rows)


class TuttiFlyer(StandardFlyable[FlightInfo, Flight]):
    """Flies scans, and writes their rows. path_provider: names the file of each flight, which must not exist."""

    def __init__(self, connection: TuttiConnection, path_provider: PathProvider, name: str = "") -> None:
        self.connection = connection
        self._path_provider = path_provider
        self.collections_written, self.set_written = soft_signal_r_and_setter(int, 0)
        self._provider: StreamResourceDataProvider | None = None
        super().__init__(name=name)

    @cached_property
    def flyable_logic(self) -> FlightLogic:
        """How it flies."""
        return FlightLogic(self)

    # Documents

    def open_file(self, axes: list[str]) -> RowFile:
        """The file of a flight, of which documents are made from now on. Raises `OSError`."""
        info = self._path_provider(self.name)
        file = RowFile(Path(info.directory_path) / f"{info.filename}.h5", axes, self.connection.reader.find_utc_s)
        self.set_written(0)
        uri = f"{info.directory_uri}{info.filename}.h5"
        resources = file.list_resources(self.name)
        self._provider = StreamResourceDataProvider(uri, resources, "application/x-hdf5", self.collections_written)
        return file

    @property
    def hints(self) -> Hints:
        """Nothing is plotted without being asked for: a stream has no events."""
        return Hints(fields=[])

    async def describe_collect(self) -> dict[str, DataKey]:
        """The columns of the flight that is prepared. Raises `RuntimeError` before that."""
        return await self._require_provider().make_datakeys(1)

    async def collect_asset_docs(self, index: int | None = None) -> AsyncIterator[StreamAsset]:
        """Documents of the rows that were written, up to `index`. Raises `RuntimeError` before it was prepared."""
        rows = await self.get_index() if index is None else index
        async for document in self._require_provider().make_stream_docs(rows, 1):
            yield document

    async def get_index(self) -> int:
        """The number of rows that are written."""
        return await self.collections_written.get_value()

    def _require_provider(self) -> StreamResourceDataProvider:
        if self._provider is None:
            raise RuntimeError(f"{self.name}: prepare() must be called before its data are described")
        return self._provider

    @WatchableAsyncStatus.wrap
    async def complete(self) -> AsyncIterator[WatcherUpdate[int]]:
        """Wait until it is flown and its rows are written; shows how many are."""
        flight = self.flyable_logic.flight
        status = super().complete()
        if flight is not None:
            async for rows in observe_value(self.collections_written, done_status=status):
                yield WatcherUpdate(current=rows, initial=0, target=flight.frames, name=self.name, unit="rows")
        await status


def make_scan(info: FlightInfo) -> tuple[Scan, list[str]]:
    """The scan of a flight, and its axes. Raises `ValueError` for a spec that states no duration."""
    names = {find_name(axis): find_axis(axis) for axis in info.spec.axes()}
    spec = rename_axes(info.spec.serialize(), names)
    fly = None
    if info.trigger is not None:
        duration_s = info.spec.duration()
        if not isinstance(duration_s, float | int):
            raise ValueError(f"the spec {info.spec} states no time at each point; write `0.02 @ spec`")
        fly = {"duration": f"{round(duration_s * 1e9)} ns", "trigger": info.trigger}
    return Scan(scanspec=spec, fly=fly), list(names.values())


def find_axis(axis: object) -> str:
    """The `controller.axis` of an axis of a spec."""
    return axis.axis if isinstance(axis, TuttiAxis) else str(axis)


def find_name(axis: object) -> str:
    """How a spec in its JSON form names an axis."""
    return axis.name if isinstance(axis, TuttiAxis) else str(axis)


def rename_axes(node: Any, names: dict[str, str]) -> Any:
    """A spec in its JSON form with other names of its axes."""
    if isinstance(node, list):
        return [rename_axes(part, names) for part in cast(list[Any], node)]
    if not isinstance(node, dict):
        return node
    return {
        key: names.get(part, part) if key.endswith("axis") and isinstance(part, str) else rename_axes(part, names)
        for key, part in cast(dict[str, Any], node).items()
    }


async def wait_until_armed(job: SubmittedJob) -> None:
    """Return when a job waits armed. Raises `JobFailed` if it ends instead."""
    async with aclosing(cast(AsyncGenerator[Any], job.events())) as events:
        async for event in events:
            if isinstance(event, JobProgress) and event.armed is not None:
                return
    raise JobFailed(await job.result())


async def cancel_job(job: SubmittedJob) -> None:
    """End a job that may have ended."""
    with suppress(Refusal):
        await job.cancel()
