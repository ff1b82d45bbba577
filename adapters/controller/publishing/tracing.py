"""The bytes of a controller's link on the bus, in parts that do not delay polls."""

from base64 import b64encode
from collections.abc import Sequence

from adapters.controller.state.context import ControllerContext
from orchestrator.link.trace import TraceEntry
from orchestrator.model.messages import TracedBytes, TracePart, TraceRequest

MAX_TRACE_PART_BYTES = 100_000  # of bytes in one answer


def read_trace_part(context: ControllerContext, request: TraceRequest) -> TracePart:
    """Return the first of the requested entries, up to the limits of one answer."""
    ring, now_ns, scale = context.trace, context.clock.now_ns(), context.scale()
    first = request.after_entry + 1
    if request.last_ns is not None:
        first = max(first, ring.first_since(now_ns - request.last_ns))
    begin = max(first, ring.oldest)
    return TracePart(
        make=context.make.name,
        options=context.config.options,
        entries=_encode_entries(ring.entries_from(begin, request.limit), begin),
        newest=ring.newest,
        lost=begin - first if request.after_entry else 0,
        utc=context.clock.utc(),
        host_ns=now_ns,
        fleet_ns=None if scale is None else scale.to_fleet_ns(now_ns),
    )


def _encode_entries(entries: Sequence[TraceEntry], begin: int) -> list[TracedBytes]:
    """The entries, numbered from `begin`, as many as are allowed; at least one."""
    traced_parts: list[TracedBytes] = []
    size = 0
    for number, (at_ns, direction, data) in enumerate(entries, start=begin):
        size += len(data)
        if traced_parts and size > MAX_TRACE_PART_BYTES:
            break
        traced_parts.append(TracedBytes(number=number, at_ns=at_ns, direction=direction, data=b64encode(data).decode()))
    return traced_parts
