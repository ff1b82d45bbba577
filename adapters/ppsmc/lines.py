"""Trigger lines of a step in the controller's own terms: the input that starts it, the output that it drives."""

from adapters.ppsmc.options import PpSmcOptions
from adapters.toolkit.firing import learned_terms
from adapters.toolkit.wired_points import WiredInput, WiredOutput
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.latency import StartLatency
from orchestrator.model.messages import BudgetTerm

LOWEST_POINT = 0  # the number of the input or output in bit 0


def wait_text(wait: WiredInput) -> str:
    """Return the part of a program line that waits for an input (L3550)."""
    return f"in{wait.bit}.{int(wait.active)}"


def switch_text(drive: WiredOutput) -> str:
    """Return the part of a program line that switches an output (L3728, L3782)."""
    return f"{'set' if drive.active else 'res'}{drive.bit}"


def starting_terms(options: PpSmcOptions, start: StartLatency, *, program: bool) -> tuple[BudgetTerm, ...]:
    """Return the terms of a start by the host relative to T0: the command is written so that it is usually executed at
    T0.

    program: it starts a program, whose axes move after its output has been switched.
    """
    last_ns = start.latest_ns - (options.wire_jitter_us - (options.line_start_us if program else 0)) * NS_PER_US
    first_ns, last_ns = start.earliest_ns + start.learned_early_ns, last_ns - start.learned_late_ns
    firmware = _firmware_term(first_ns - start.usual_ns, last_ns - start.usual_ns)
    return (*_transmission_terms(options), firmware, *learned_terms(start))


def edge_terms(options: PpSmcOptions, start: StartLatency) -> tuple[BudgetTerm, ...]:
    """Return the terms of the edge of a driven trigger line relative to T0."""
    quick_ns, slow_ns = options.decode_ns
    last_ns = slow_ns + options.line_start_us * NS_PER_US
    return (*_transmission_terms(options), _firmware_term(quick_ns - start.usual_ns, last_ns - start.usual_ns))


def _transmission_terms(options: PpSmcOptions) -> tuple[BudgetTerm, ...]:
    return (
        options.host_term(),
        BudgetTerm(name="wire", earliest_ns=0, latest_ns=options.wire_jitter_us * NS_PER_US),
    )


def _firmware_term(first_ns: int, last_ns: int) -> BudgetTerm:
    return BudgetTerm(name="firmware", earliest_ns=first_ns, latest_ns=last_ns)
