"""Triggers of a motion step: what the owners of their outputs are asked for."""

from collections.abc import Mapping, Sequence

from orchestrator.model.messages import OutputTrigger
from orchestrator.model.names import split_name
from orchestrator.plan.step import StepPlan
from orchestrator.plan.triggers import ResolvedTrigger, group_by_owner


class StepTriggers:
    """The triggers of one step, for a plan that may still be stretched."""

    def __init__(self, triggers: Sequence[ResolvedTrigger] = ()) -> None:
        self.triggers = triggers
        self._found: tuple[StepPlan, dict[str, list[OutputTrigger]]] | None = None

    @property
    def owners(self) -> list[str]:
        """The controllers of the outputs; they are members of the step."""
        return list(group_by_owner(self.triggers))

    def find_outputs(self, plan: StepPlan) -> Mapping[str, list[OutputTrigger]]:
        """By controller, what it is to switch in this plan. Raises `Refusal`."""
        if self._found is None or self._found[0] is not plan:
            triggers = {
                owner: [
                    OutputTrigger(
                        output=split_name(trigger.output)[1],
                        axis=find_own_axis(trigger),
                        instants_ns=trigger.find_instants_ns(plan),
                        pulse_ns=trigger.pulse_ns,
                    )
                    for trigger in group
                ]
                for owner, group in group_by_owner(self.triggers).items()
            }
            self._found = plan, triggers
        return self._found[1]


def find_own_axis(trigger: ResolvedTrigger) -> str | None:
    """The axis of a trigger, if it belongs to the owner of the output."""
    if trigger.axis is None:
        return None
    controller, axis = split_name(trigger.axis)
    return axis if controller == trigger.owner else None
