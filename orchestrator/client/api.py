"""The asynchronous API: submit jobs, follow them, watch the fleet, stop it. The command line is built on it.

async with Tutti("tcp/127.0.0.1:7447") as tutti:
    job = await tutti.submit(load_job(Path("demo.job.yaml")))
    async for event in job.events():
        print(event)
    report = await job.result()
"""

from orchestrator.client.axes import AxisRequests
from orchestrator.client.live import LiveRequests
from orchestrator.client.operation import OperationRequests
from orchestrator.client.positions import PositionRequests
from orchestrator.client.readings import ReadingRequests
from orchestrator.client.tracebacks import end_tracebacks


@end_tracebacks
class Tutti(LiveRequests, AxisRequests, PositionRequests, ReadingRequests, OperationRequests):
    """A connection to one fleet, with all requests; use it as a context. For its arguments see `FleetConnection`."""
