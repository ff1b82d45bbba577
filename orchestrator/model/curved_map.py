"""Maps of positions that are not linear: named forms, and code of installed packages (`tutti.kinematics`).

They compute with floats: a target is as exact as these, far below a count.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol, runtime_checkable

from orchestrator.model.linear_map import MapError, Rows

DIFFERENCE = 1e-5
"""Of a position, or of 1 if that is more: the step of a numeric derivative."""
HC_EV_MM = 1.239841984332e-3
"""Planck constant x speed of light / elementary charge, eV mm: exact in the SI of 2019 (CODATA 2018, hc/e)."""


class Kinematics(Protocol):
    """What `tutti.kinematics` provides: how virtual positions follow from real ones, and back.

    of: the units of its real axes, in order. axes: its virtual axes with their units, in order; as many as real ones.
    Both functions take and return positions in these units, in order, and raise `ValueError` with the reason for a
    position outside their domain. They keep no state, and return within a fraction of a millisecond. With a method
    `derivatives(real)` (a row for each virtual axis, a number for each real one) no numeric one is taken.
    """

    @property
    def of(self) -> Sequence[str]: ...

    @property
    def axes(self) -> Mapping[str, str]: ...

    def to_virtual(self, real: Sequence[float], /) -> Sequence[float]: ...

    def to_real(self, virtual: Sequence[float], /) -> Sequence[float]: ...


@runtime_checkable
class WithDerivatives(Protocol):
    """Kinematics that know their derivatives."""

    def derivatives(self, real: Sequence[float], /) -> Sequence[Sequence[float]]: ...


@dataclass(frozen=True)
class CurvedMap:
    """A map by kinematics, in the units of the axes.

    real, virtual: names of axes in order. real_sizes, virtual_sizes: of the units of the axes, in those of the
    kinematics. label: what it is, for messages.
    """

    real: tuple[str, ...]
    virtual: tuple[str, ...]
    kinematics: Kinematics
    real_sizes: tuple[float, ...]
    virtual_sizes: tuple[float, ...]
    label: str

    def to_virtual(self, positions: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Virtual positions of real ones, in order. Raises `MapError`."""
        return tuple(map(Fraction, self.observe(list(map(float, positions)))))

    def to_real(self, positions: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Real positions of virtual ones, in order. Raises `MapError`."""
        values = [float(position) * size for position, size in zip(positions, self.virtual_sizes, strict=True)]
        real = self._call(self.kinematics.to_real, values, len(self.real))
        return tuple(Fraction(value / size) for value, size in zip(real, self.real_sizes, strict=True))

    def observe(self, positions: Sequence[float]) -> tuple[float, ...]:
        """Virtual positions of real ones, in order. Raises `MapError`."""
        values = [position * size for position, size in zip(positions, self.real_sizes, strict=True)]
        virtual = self._call(self.kinematics.to_virtual, values, len(self.virtual))
        return tuple(value / size for value, size in zip(virtual, self.virtual_sizes, strict=True))

    def find_rows(self, positions: Sequence[float]) -> Rows:
        """How much each virtual axis moves per unit of each real one, at real positions. Raises `MapError`."""
        kinematics, count = self.kinematics, len(self.real)
        if not isinstance(kinematics, WithDerivatives):
            return self._find_differences(positions)
        values = [position * size for position, size in zip(positions, self.real_sizes, strict=True)]

        def find_numbers(real: Sequence[float]) -> Sequence[float]:
            return [number for row in kinematics.derivatives(real) for number in row]

        numbers = self._call(find_numbers, values, count * count)
        return tuple(
            tuple(
                numbers[row * count + column] * self.real_sizes[column] / self.virtual_sizes[row]
                for column in range(count)
            )
            for row in range(count)
        )

    def _find_differences(self, positions: Sequence[float]) -> Rows:
        columns: list[list[float]] = []
        for number, position in enumerate(positions):
            step = DIFFERENCE * max(1.0, abs(position))
            low, high = (
                self.observe([*positions[:number], position + offset, *positions[number + 1 :]])
                for offset in (-step, step)
            )
            columns.append([(end - begin) / (2 * step) for begin, end in zip(low, high, strict=True)])
        return tuple(zip(*columns, strict=True))

    def _call(
        self, function: Callable[[Sequence[float]], Sequence[float]], values: list[float], count: int
    ) -> list[float]:
        """The answer of the kinematics, which may be code of users. Raises `MapError`."""
        try:
            answer = list(map(float, function(values)))
        except ValueError as error:
            raise MapError(f"{self.label}: {error}") from None
        except Exception as error:
            raise MapError(f"{self.label}: its code failed with {type(error).__name__}: {error}") from None
        if len(answer) != count or not all(map(math.isfinite, answer)):
            place_words = ", ".join(f"{value:g}" for value in values)
            raise MapError(f"{self.label}: its code answers with {answer} at {place_words}; expected {count} numbers")
        return answer


class SineBar:
    """A bar between two rollers, one of which a linear axis lifts: sin angle = lift / length + sin offset.

    length: mm. offset: the angle at 0, rad.
    """

    of = ("mm",)
    axes: Mapping[str, str] = {"angle": "rad"}

    def __init__(self, length: float, offset: float) -> None:
        self._length, self._sine = length, math.sin(offset)

    def to_virtual(self, real: Sequence[float]) -> Sequence[float]:
        """The angle, rad, of a lift, mm."""
        sine = real[0] / self._length + self._sine
        if not abs(sine) < 1.0:
            raise ValueError(f"a lift of {real[0]:g} mm is beyond its length, {self._length:g} mm")
        return (math.asin(sine),)

    def to_real(self, virtual: Sequence[float]) -> Sequence[float]:
        """The lift, mm, of an angle, rad."""
        if not abs(virtual[0]) < math.pi / 2:
            raise ValueError(f"an angle of {math.degrees(virtual[0]):g} deg is not below 90 deg")
        return ((math.sin(virtual[0]) - self._sine) * self._length,)

    def derivatives(self, real: Sequence[float]) -> Sequence[Sequence[float]]:
        """Of the angle, rad/mm."""
        return ((1.0 / (self._length * math.cos(self.to_virtual(real)[0])),),)


class CrystalEnergy:
    """The energy that a crystal reflects, by Bragg's law, and the exit of two parallel ones.

    E = hc / (2 d sin theta), exit = 2 s cos theta, with s the distance of the crystals' surfaces. spacing: d, mm.
    offset: theta where its axis is at 0, rad. with_exit: whether s is an axis.
    """

    def __init__(self, spacing: float, offset: float, *, with_exit: bool) -> None:
        self.of = ("rad", "mm")[: 1 + with_exit]
        self.axes: Mapping[str, str] = {"energy": "eV", "exit": "mm"} if with_exit else {"energy": "eV"}
        self._least, self._offset = HC_EV_MM / (2.0 * spacing), offset

    def to_virtual(self, real: Sequence[float]) -> Sequence[float]:
        """Energy, eV, and exit, mm, of an angle, rad, and a distance, mm."""
        theta = real[0] + self._offset
        if not 0.0 < theta < math.pi / 2:
            raise ValueError(f"theta is {math.degrees(theta):g} deg; it must be above 0 and below 90 deg")
        return (self._least / math.sin(theta), *(2.0 * distance * math.cos(theta) for distance in real[1:]))

    def to_real(self, virtual: Sequence[float]) -> Sequence[float]:
        """Angle, rad, and distance, mm, of an energy, eV, and an exit, mm."""
        if not virtual[0] > self._least:
            raise ValueError(f"an energy of {virtual[0]:g} eV is not above {self._least:g} eV, that of 90 deg")
        theta = math.asin(self._least / virtual[0])
        return (theta - self._offset, *(exit_ / (2.0 * math.cos(theta)) for exit_ in virtual[1:]))

    def derivatives(self, real: Sequence[float]) -> Sequence[Sequence[float]]:
        """Of energy and exit, by angle and distance."""
        theta = real[0] + self._offset
        rate = -self._least * math.cos(theta) / math.sin(theta) ** 2
        if len(real) == 1:
            return ((rate,),)
        return (rate, 0.0), (-2.0 * real[1] * math.sin(theta), 2.0 * math.cos(theta))
