"""Lowering of profiles to the moves of a make: for a proposal, and once more for the T0 that was agreed."""

import asyncio

from adapters.contract import require_triggers
from adapters.controller.slots.fleet_durations import find_last_instants, state_move, to_host_profiles, to_host_start
from adapters.controller.slots.step_checks import StepChecks
from adapters.controller.state.armed_step import ArmedStep
from adapters.controller.state.axis_way import AxisWay
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.next_step import PreparedMove
from orchestrator.model.errors import LATE_REMEDY, Refusal
from orchestrator.model.messages import ArmRequest, Proposal, ProposeRequest, StartAtOnceRequest


class StepLowering:
    """Checks and lowers the steps of one controller. One controller of a host lowers at a time."""

    def __init__(self, context: ControllerContext, steps: LoadedSteps, checks: StepChecks) -> None:
        self._context = context
        self._steps = steps
        self._checks = checks

    async def propose_step(self, request: ProposeRequest) -> Proposal:
        """Lower the profiles without accessing the controller."""
        async with self._context.lowering_lock:
            await asyncio.sleep(0)
            check = self._checks.check_following_step if request.start.follows else self._checks.check_step
            check(request)
            if not request.rehearsal:
                self._steps.requested_ns = self._context.clock.now_ns()
            scale, mapping = self._context.require_scale(), self._context.driver.clock_mapping()
            start = to_host_start(request.start, scale)
            lowered_step = self._context.driver.lower_profiles(
                to_host_profiles(request.profiles, scale), start, mapping
            )
            require_triggers(lowered_step, start)
        at_ticks = mapping is not None and lowered_step.tick_ns > 0 and lowered_step.start_class == "clock"
        statement = state_move(
            lowered_step, scale, self._context.clock.now_ns() + start.lead_ns, find_last_instants(start)
        )
        return Proposal(
            tick_at_fleet_ns=scale.to_fleet_ns(mapping.host_at_ns) if at_ticks and mapping is not None else None,
            durations_s=statement.durations_s,
            path_error_counts=dict(lowered_step.path_error_counts),
            costs=lowered_step.costs,
            start_class=lowered_step.start_class,
            tick_ns=statement.tick_ns,
            terms=statement.terms,
            edge=statement.edge,
            triggers=statement.triggers,
            trigger_least_ns=dict(lowered_step.trigger_least_ns),
            clock_ppm=statement.clock_ppm,
            can_advance=lowered_step.can_advance,
            gap_ns=lowered_step.gap_ns if request.start.follows else None,
            commands=list(lowered_step.commands),
            starts_at_once=lowered_step.release_ns is not None,
        )

    async def prepare_at_once(self, request: StartAtOnceRequest, *, follows: bool) -> PreparedMove:
        """Lower a move that starts as soon as it can, for a T0 that loading it does not miss. Raises `Refusal`."""
        fields = {name: value for name, value in request if name in ArmRequest.model_fields}
        fields["start"] = request.start.model_copy(update={"at_once": True})
        t0_fleet_ns = self._context.require_scale().to_fleet_ns(self._context.clock.now_ns() + request.lead_ns)
        t0_fleet_ns = max(t0_fleet_ns, request.not_before_fleet_ns)
        return await self.prepare_move(ArmRequest(**fields, t0_fleet_ns=t0_fleet_ns), follows=follows)

    async def prepare_move(self, request: ArmRequest, *, follows: bool) -> PreparedMove:
        """Lower the move for T0. Raises `Refusal`."""
        began_ns = self._context.clock.now_ns()
        async with self._context.lowering_lock:
            # One turn of the event loop, for everything that arrived during the last lowering.
            await asyncio.sleep(0)
            check = self._checks.check_following_step if follows else self._checks.check_step
            check(request)
            self._steps.requested_ns = self._context.clock.now_ns()
            scale, mapping = self._context.require_scale(), self._context.driver.clock_mapping()
            t0_ns = scale.to_host_ns(request.t0_fleet_ns)
            lead_ns = 0 if mapping is None else max(0, t0_ns - mapping.host_at_ns)
            start = to_host_start(request.start, scale).model_copy(update={"lead_ns": lead_ns, "exact": True})
            lowered_step = self._context.driver.lower_profiles(
                to_host_profiles(request.profiles, scale), start, mapping
            )
            require_triggers(lowered_step, start)
        if self._context.clock.now_ns() + lowered_step.costs.disarm_ns >= t0_ns:
            raise Refusal("late", "T0 is too near to arm; the arm request came late", LATE_REMEDY)
        armed_step = ArmedStep(
            job=request.job,
            step=request.step,
            t0_fleet_ns=request.t0_fleet_ns,
            t0_host_ns=t0_ns,
            axes=tuple(request.profiles),
            scale=scale,
            can_advance=lowered_step.can_advance,
            promised_s=dict(lowered_step.durations_s),
            clock_ppm=lowered_step.clock_ppm,
            ways={
                axis: AxisWay.from_profile(profile, lowered_step.path_error_counts.get(axis, 0.0))
                for axis, profile in request.profiles.items()
            },
            early_ns=max(0, -lowered_step.window_ns[0]),
        )
        return PreparedMove(request, armed_step, lowered_step, mapping, began_ns)
