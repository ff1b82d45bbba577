"""Points of scans that clients send before their jobs, and the points that a job names."""

import base64
import binascii

from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.facts import UploadState
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.service import PointsPut, PutPoints
from orchestrator.model.names import controller_of
from orchestrator.model.steps.points import PointTable, find_row_bytes
from orchestrator.model.steps.scan import Scan
from orchestrator.model.steps.tree import find_scans


class PointIntake:
    """Takes points into the store, and finds those that jobs name there."""

    def __init__(self, services: JobServices) -> None:
        self._services = services

    async def put_points(self, request: PutPoints) -> PointsPut:
        """Store a part of points; without data, begin or continue. Raises `Refusal`, `UnknownName`, `JournalError`."""
        services, store = self._services, self._services.journal.points
        utc = services.clock.utc()
        if request.data:
            try:
                data = base64.b64decode(request.data, validate=True)
            except binascii.Error as error:
                raise Refusal("bad-points", f"the data cannot be read: {error}", "send base64") from None
            state = await services.execute(store.add_part, request.digest, request.begin, data, utc)
        else:
            for axis in request.axes:
                unit = services.view.fleet.axis(axis.axis).unit
                if unit != axis.unit:
                    text = f"the points of {axis.axis} are in {axis.unit}, and the axis is in {unit}"
                    raise Refusal("bad-unit", text, "convert them", controller_of(axis.axis))
            named_points = await services.execute(services.journal.list_named_points)
            begin = store.begin_upload
            state = await services.execute(begin, request.digest, request.axes, request.count, utc, named_points)
        return PointsPut(received=state.received, points=_make_table(request.digest, state))

    async def resolve_points(self, job: Job) -> Job:
        """The job with the extremes of its stored points as the store has found them. Raises `Refusal`, code
        `unknown-points`, for points that are not stored."""
        stored_scans = [
            scan for scan in find_scans(job.steps) if not scan.axes and not (scan.points and scan.points.rows)
        ]
        if not stored_scans:
            return job
        scans = {id(scan): await self._resolve_scan(scan) for scan in stored_scans}
        return job.model_copy(update={"steps": [step.replace_steps(scans) for step in job.steps]})

    async def _resolve_scan(self, scan: Scan) -> Scan:
        digest = None if scan.points is None else scan.points.digest
        if digest is None:
            text = "the points of a scan are in a file of the client, which has to read and send them"
            raise Refusal("unknown-points", text, "send them first: `svc/put-points`, as `tutti submit` does")
        services = self._services
        state = await services.execute(services.journal.points.find_upload, digest, services.clock.utc())
        table = None if state is None else _make_table(digest, state)
        if table is None:
            text = f"the points {digest[:15]}… are not stored"
            raise Refusal("unknown-points", text, "submit the job again, with its file of points")
        return scan.model_copy(update={"points": table})


def _make_table(digest: str, state: UploadState) -> PointTable | None:
    """The stored points; None while they are not complete."""
    if state.columns is None:
        return None
    count = state.size // find_row_bytes(state.columns)
    return PointTable(digest=digest, count=count, columns=state.columns)
