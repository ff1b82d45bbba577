"""Drivers of one step, each on a link of its own, seen as one driver: as a coordinator treats the members of a step."""

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from adapters.abilities import LimitDriver, ManualDriver, set_output
from adapters.contract import (
    AxisReading,
    ControllerIdentity,
    ControllerReading,
    Driver,
    DriverCapabilities,
    HostInterval,
    JogMove,
    LoadPlace,
    Lowered,
    MoveOutcome,
    MoveSlot,
    MoveSlots,
)
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import StepCosts

T = TypeVar("T")


async def at_once(calls: Iterable[Awaitable[T]]) -> list[T]:
    """The results of all of them. The first failure is raised when all have ended."""
    results = await asyncio.gather(*calls, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return [result for result in results if not isinstance(result, BaseException)]


def highest(costs: Sequence[StepCosts]) -> StepCosts:
    return StepCosts(
        arm_ns=max(cost.arm_ns for cost in costs),
        disarm_ns=max(cost.disarm_ns for cost in costs),
        stop_ns=max(cost.stop_ns for cost in costs),
    )


@dataclass(frozen=True, slots=True)
class LoweredTogether(Lowered):
    """parts: by the number of the driver."""

    parts: Mapping[int, Lowered]


class MoverTogether:
    """The move of several drivers: each call goes to the present slots of all that it concerns."""

    def __init__(self, drivers: Sequence[Driver]) -> None:
        self._drivers = drivers
        self._members: list[MoveSlot] = []

    async def load(
        self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None, place: LoadPlace
    ) -> Mapping[str, int]:
        assert isinstance(lowered, LoweredTogether)
        parts = {self._drivers[number].slots.present: part for number, part in lowered.parts.items()}
        self._members = list(parts)
        stages = await at_once(slot.load(part, t0_ns, mapping, place) for slot, part in parts.items())
        return {name: max(stage_costs.get(name, 0) for stage_costs in stages) for name in stages[0]}

    async def verify(self) -> None:
        await at_once(member.verify() for member in self._members)

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        await at_once(member.release(start_tolerance_ns, advance_ns) for member in self._members)

    async def unload(self) -> None:
        await at_once(driver.slots.unload() for driver in self._drivers)

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        start_spans = await at_once(member.wait_for_start() for member in self._members)
        return {axis: span for spans in start_spans for axis, span in spans.items()}

    async def wait_for_end(self) -> MoveOutcome:
        """As one that failed, if there is one."""
        outcomes = await at_once(member.wait_for_end() for member in self._members)
        worst = next((outcome for outcome in outcomes if outcome.state != "done"), outcomes[0])
        end_spans = {axis: at for outcome in outcomes for axis, at in outcome.ended.items()}
        return MoveOutcome(worst.state, end_spans, worst.reason)


class Together(Driver):
    """Drivers of the same make whose clock cannot be read: no mapping would apply to all. Each call goes to all
    drivers that it concerns, at the same instant. Inputs and outputs are those of the first one."""

    def __init__(self, drivers: Mapping[Driver, Sequence[str]]) -> None:
        """drivers: with their axes, which are no other's."""
        self._drivers = list(drivers)
        self._axes = [set(axes) for axes in drivers.values()]
        self._slots = MoveSlots(MoveSlot(MoverTogether(self._drivers)))

    def _of(self, axes: Sequence[str]) -> list[tuple[Driver, list[str]]]:
        """The drivers of some axes, each with its own."""
        parts = [(driver, [axis for axis in axes if axis in own]) for driver, own in self._each()]
        return [(driver, own) for driver, own in parts if own]

    def _each(self) -> Iterable[tuple[Driver, set[str]]]:
        return zip(self._drivers, self._axes, strict=True)

    async def connect(self) -> ControllerIdentity:
        identities = await at_once(driver.connect() for driver in self._drivers)
        return ControllerIdentity(
            model=" ".join(identity.model for identity in identities),
            firmware=" ".join(identity.firmware for identity in identities),
            serial=" ".join(identity.serial for identity in identities),
        )

    async def configure(self) -> None:
        await at_once(driver.configure() for driver in self._drivers)

    @property
    def capabilities(self) -> DriverCapabilities:
        """The first one's, which all have; costs are those that hold for all."""
        capabilities = [driver.capabilities for driver in self._drivers]
        first, costs = capabilities[0], highest([driver_capabilities.costs for driver_capabilities in capabilities])
        return DriverCapabilities(first.start_classes, first.orders, first.independent_axes, costs)

    async def poll(self) -> ControllerReading:
        readings = await at_once(driver.poll() for driver in self._drivers)
        axes: dict[str, AxisReading] = {}
        for reading in readings:
            axes |= reading.axes
        return ControllerReading(
            at_ns=readings[0].at_ns,
            axes=axes,
            inputs=readings[0].inputs,
            outputs=readings[0].outputs,
            faults=[fault for reading in readings for fault in reading.faults],
            restarted=any(reading.restarted for reading in readings),
        )

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> LoweredTogether:
        """A trigger line is driven by the first one. Drivers of one make start alike; costs are those that hold for
        all."""
        parts: dict[int, Lowered] = {}
        for number, (driver, own) in enumerate(self._each()):
            its = {axis: profile for axis, profile in profiles.items() if axis in own}
            its_way = start if number == 0 else start.model_copy(update={"drive": None})
            if its or its_way.drive is not None:
                parts[number] = driver.lower_profiles(its, its_way, mapping)
        steps = list(parts.values())
        first = steps[0]
        assert all((step.start_class, step.terms) == (first.start_class, first.terms) for step in steps)
        return LoweredTogether(
            start_class=first.start_class,
            durations_s={axis: s for step in steps for axis, s in step.durations_s.items()},
            path_error_counts={axis: counts for step in steps for axis, counts in step.path_error_counts.items()},
            terms=first.terms,
            tick_ns=max(step.tick_ns for step in steps),
            costs=highest([step.costs for step in steps]),
            commands=tuple(command for step in steps for command in step.commands),
            parts=parts,
            edge=first.edge,
            clock_ppm=max(step.clock_ppm for step in steps),
            can_advance=all(step.can_advance for step in steps),
        )

    @property
    def slots(self) -> MoveSlots:
        return self._slots

    async def stop(self, *, abort: bool) -> None:
        await at_once(driver.stop(abort=abort) for driver in self._drivers)

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        await at_once(driver.set_enabled(own, on=on) for driver, own in self._of(axes))

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        failures = await at_once(driver.home_axes(own, found) for driver, own in self._of(axes))
        return {axis: reason for driver_failures in failures for axis, reason in driver_failures.items()}

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        await at_once(driver.jog_axis(axis, move) for driver, _ in self._of([axis]) if isinstance(driver, ManualDriver))

    async def stop_axes(self, axes: Sequence[str]) -> None:
        await at_once(driver.stop_axes(own) for driver, own in self._of(axes) if isinstance(driver, ManualDriver))

    async def load_soft_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        await at_once(
            driver.load_soft_limits({axis: limits[axis] for axis in own})
            for driver, own in self._of(list(limits))
            if isinstance(driver, LimitDriver)
        )

    async def set_output(self, number: int, *, on: bool) -> None:
        await set_output(self._drivers[0], number, on=on)

    async def clear_faults(self) -> None:
        await at_once(driver.clear_faults() for driver in self._drivers)

    async def send_raw(self, command: str) -> str:
        return await self._drivers[0].send_raw(command)

    async def close(self) -> None:
        await at_once(driver.close() for driver in self._drivers)
