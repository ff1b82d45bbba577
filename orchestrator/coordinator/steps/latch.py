"""An input captures the position of an axis."""

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.steps.context import ANSWER_S, ReportFields, StepContext
from orchestrator.model.messages import LatchReply, LatchRequest, raise_first_refusal
from orchestrator.model.names import split_name
from orchestrator.model.report import LatchReport
from orchestrator.model.state import TimeInterval
from orchestrator.model.steps.latch import Latch


async def run_latch(context: StepContext, step: Latch) -> ReportFields:
    """Have the controller capture a position, which the report states as `latch`. Raises `Refusal`."""
    (controller, axis), view = split_name(step.axis), context.fleet.view
    request = LatchRequest(
        **context.request_fields,
        axes=[axis],
        holder=context.holder,
        input=split_name(step.input)[1],
        within_ns=step.timeout,
    )
    timeout_s = ANSWER_S + step.timeout / NS_PER_S
    replies = await context.fleet.requests.request_all("latch", {controller: request}, LatchReply, timeout_s)
    raise_first_refusal(replies)
    reply, config = replies[controller], view.fleet.axis(step.axis)
    state = view.axis_now(step.axis)
    offset = 0.0 if state is None else float(state.offset)
    report = LatchReport(
        axis=step.axis,
        input=step.input,
        position=config.to_unit(reply.counts) + offset,
        unit=config.unit,
        counts=reply.counts,
        seen=TimeInterval(earliest_ns=reply.earliest_ns, latest_ns=reply.latest_ns),
    )
    return {"latch": report}
