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
    for each in results:
        if isinstance(each, BaseException):
            raise each
    return [each for each in results if not isinstance(each, BaseException)]


def highest(costs: Sequence[StepCosts]) -> StepCosts:
    return StepCosts(
        arm_ns=max(each.arm_ns for each in costs),
        disarm_ns=max(each.disarm_ns for each in costs),
        stop_ns=max(each.stop_ns for each in costs),
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
        return {name: max(each.get(name, 0) for each in stages) for name in stages[0]}

    async def verify(self) -> None:
        await at_once(each.verify() for each in self._members)

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        await at_once(each.release(start_tolerance_ns, advance_ns) for each in self._members)

    async def unload(self) -> None:
        await at_once(each.slots.unload() for each in self._drivers)

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        started = await at_once(each.wait_for_start() for each in self._members)
        return {axis: span for each in started for axis, span in each.items()}

    async def wait_for_end(self) -> MoveOutcome:
        """As one that failed, if there is one."""
        outcomes = await at_once(each.wait_for_end() for each in self._members)
        worst = next((each for each in outcomes if each.state != "done"), outcomes[0])
        ended = {axis: at for each in outcomes for axis, at in each.ended.items()}
        return MoveOutcome(worst.state, ended, worst.reason)


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
        parts = [(one, [axis for axis in axes if axis in own]) for one, own in self._each()]
        return [(one, own) for one, own in parts if own]

    def _each(self) -> Iterable[tuple[Driver, set[str]]]:
        return zip(self._drivers, self._axes, strict=True)

    async def connect(self) -> ControllerIdentity:
        found = await at_once(each.connect() for each in self._drivers)
        return ControllerIdentity(
            model=" ".join(each.model for each in found),
            firmware=" ".join(each.firmware for each in found),
            serial=" ".join(each.serial for each in found),
        )

    async def configure(self) -> None:
        await at_once(each.configure() for each in self._drivers)

    @property
    def capabilities(self) -> DriverCapabilities:
        """The first one's, which all have; costs are those that hold for all."""
        every = [each.capabilities for each in self._drivers]
        first, costs = every[0], highest([each.costs for each in every])
        return DriverCapabilities(first.start_classes, first.orders, first.independent_axes, costs)

    async def poll(self) -> ControllerReading:
        readings = await at_once(each.poll() for each in self._drivers)
        axes: dict[str, AxisReading] = {}
        for each in readings:
            axes |= each.axes
        return ControllerReading(
            at_ns=readings[0].at_ns,
            axes=axes,
            inputs=readings[0].inputs,
            outputs=readings[0].outputs,
            faults=[fault for each in readings for fault in each.faults],
            restarted=any(each.restarted for each in readings),
        )

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> LoweredTogether:
        """A trigger line is driven by the first one. Drivers of one make start alike; costs are those that hold for
        all."""
        parts: dict[int, Lowered] = {}
        for number, (one, own) in enumerate(self._each()):
            its = {axis: profile for axis, profile in profiles.items() if axis in own}
            its_way = start if number == 0 else start.model_copy(update={"drive": None})
            if its or its_way.drive is not None:
                parts[number] = one.lower_profiles(its, its_way, mapping)
        every = list(parts.values())
        first = every[0]
        assert all((each.start_class, each.terms) == (first.start_class, first.terms) for each in every)
        return LoweredTogether(
            start_class=first.start_class,
            durations_s={axis: s for each in every for axis, s in each.durations_s.items()},
            path_error_counts={axis: counts for each in every for axis, counts in each.path_error_counts.items()},
            terms=first.terms,
            tick_ns=max(each.tick_ns for each in every),
            costs=highest([each.costs for each in every]),
            commands=tuple(command for each in every for command in each.commands),
            parts=parts,
            edge=first.edge,
            clock_ppm=max(each.clock_ppm for each in every),
            can_advance=all(each.can_advance for each in every),
        )

    @property
    def slots(self) -> MoveSlots:
        return self._slots

    async def stop(self, *, abort: bool) -> None:
        await at_once(each.stop(abort=abort) for each in self._drivers)

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        await at_once(one.set_enabled(own, on=on) for one, own in self._of(axes))

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        missed = await at_once(one.home_axes(own, found) for one, own in self._of(axes))
        return {axis: reason for each in missed for axis, reason in each.items()}

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        await at_once(one.jog_axis(axis, move) for one, _ in self._of([axis]) if isinstance(one, ManualDriver))

    async def stop_axes(self, axes: Sequence[str]) -> None:
        await at_once(one.stop_axes(own) for one, own in self._of(axes) if isinstance(one, ManualDriver))

    async def load_soft_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        await at_once(
            one.load_soft_limits({axis: limits[axis] for axis in own})
            for one, own in self._of(list(limits))
            if isinstance(one, LimitDriver)
        )

    async def set_output(self, number: int, *, on: bool) -> None:
        await set_output(self._drivers[0], number, on=on)

    async def clear_faults(self) -> None:
        await at_once(each.clear_faults() for each in self._drivers)

    async def send_raw(self, command: str) -> str:
        return await self._drivers[0].send_raw(command)

    async def close(self) -> None:
        await at_once(each.close() for each in self._drivers)
