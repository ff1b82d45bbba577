"""The triggers of one motion along a path in chunks: what each owner of an output gets with a chunk, and promises."""

from bisect import bisect_right
from collections.abc import Mapping, Sequence

from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import BudgetTerm, ChunkReply, ChunkTrigger, Proposal
from orchestrator.model.names import split_name
from orchestrator.plan.path_course import ChunkPlan
from orchestrator.plan.path_triggers import GivenTrigger, PathTrigger


class ChunkedOutput:
    """One output in one motion along a path."""

    def __init__(self, given: GivenTrigger) -> None:
        self.given = given
        self._terms: list[tuple[int, list[BudgetTerm]]] = []

    def note_terms(self, terms: list[BudgetTerm]) -> None:
        """The owner has promised this for the instants behind those that it was given so far."""
        self._terms = [entry for entry in self._terms if entry[0] < len(self.given.instants_ns)]
        self._terms.append((len(self.given.instants_ns), terms))

    def find_terms(self, number: int) -> list[BudgetTerm]:
        """What was promised for an instant, by its number from 0; nothing for one of the first chunk."""
        at = bisect_right(self._terms, number, key=lambda entry: entry[0])
        return self._terms[at - 1][1] if at else []


class FeedTriggers:
    """All outputs of one motion along a path."""

    def __init__(self, triggers: Sequence[PathTrigger], first: ChunkPlan) -> None:
        """first: chunk."""
        self.outputs = [ChunkedOutput(GivenTrigger(trigger)) for trigger in triggers]
        self.take_chunk(first)

    @property
    def owners(self) -> list[str]:
        """The controllers of the outputs."""
        return list(dict.fromkeys(output.given.trigger.resolved.owner for output in self.outputs))

    def find_parts(self, chunk: ChunkPlan) -> dict[str, list[ChunkTrigger]]:
        """By owner, what comes with a chunk."""
        parts: dict[str, list[ChunkTrigger]] = {}
        for output in self.outputs:
            owner, name = split_name(output.given.trigger.resolved.output)
            first, instants_ns = output.given.find_part(chunk)
            parts.setdefault(owner, []).append(ChunkTrigger(output=name, first=first, instants_ns=instants_ns))
        return parts

    def note_promises(self, replies: Mapping[str, ChunkReply]) -> None:
        """All members have loaded a chunk that is released next."""
        for output in self.outputs:
            owner, name = split_name(output.given.trigger.resolved.output)
            output.note_terms(replies[owner].triggers.get(name, []))

    def take_chunk(self, chunk: ChunkPlan) -> None:
        """A chunk is released."""
        for output in self.outputs:
            output.given.take_part(chunk)

    def skip_tail(self, chunk: ChunkPlan) -> None:
        """The motion comes to rest at the end of the chunk's tail."""
        for output in self.outputs:
            output.given.skip_tail(chunk)

    def require_rate(self, rate: float, proposals: Mapping[str, Proposal]) -> None:
        """Raise `Refusal` for a rate above 1 at which instants would follow faster than their owner takes them, by its
        proposal."""
        for output in self.outputs:
            motion_trigger, trigger = output.given.trigger, output.given.trigger.resolved
            needs_ns = proposals[trigger.owner].trigger_least_ns.get(split_name(trigger.output)[1], 0)
            gap_ns = motion_trigger.least_ns / rate
            if rate > 1.0 and motion_trigger.gets_faster and 0 < gap_ns < needs_ns:
                text = f"at {rate:.0%} triggers of {trigger.output} would be {gap_ns / NS_PER_MS:.3g} ms apart"
                remedy = f"its controller takes one in {needs_ns / NS_PER_MS:.3g} ms: choose a lower speed"
                raise Refusal("override", text, remedy, trigger.owner)
