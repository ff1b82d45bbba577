"""Frames of coordinates, in which paths are given."""

from math import cos, radians, sin, tan
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, PrivateAttr, model_validator

from orchestrator.model.base import Model
from orchestrator.model.linear_map import CorrectedMap
from orchestrator.model.units import Quantity, Unit, parse_quantity

if TYPE_CHECKING:  # loaded where a frame is used: most programs need the models only
    import numpy as np
    from numpy.typing import NDArray

    Matrix = NDArray[np.float64]

MAX_COORDINATES = 32
# A frame that maps a small square to one so much longer than wide has lost a coordinate in practice.
WORST_CONDITION = 1e6

Factor = Annotated[float, Field(allow_inf_nan=False)]


class FrameSpec(Model):
    """Positions of axes = offset + matrix x coordinates; the matrix is given, or made of scale, skew and rotation."""

    axes: list[str] = Field(min_length=1, max_length=MAX_COORDINATES, description="Axes `controller.axis`, in order.")
    coordinates: list[str] = Field(min_length=1, description="Names of the coordinates, as many as there are axes.")
    unit: Unit = Field(default=Unit.MM, description="The unit of all coordinates.")
    scale: list[Factor] | None = Field(default=None, description="One factor for each coordinate; 1 without it.")
    skew: Factor = Field(
        default=0.0,
        gt=-89,
        lt=89,
        description="Degrees by which the second coordinate leans towards the first from a right angle.",
    )
    rotation: Factor | list[Factor] = Field(
        default=0.0,
        description="Degrees, from the first coordinate towards the second; or three angles, about the first, the "
        "second and the third coordinate, in this order.",
    )
    matrix: list[list[Factor]] | None = Field(
        default=None, description="Instead of scale, skew and rotation: a row for each axis, in its unit per `unit`."
    )
    offset: list[Quantity] | None = Field(default=None, description="Positions of the axes at the coordinates' origin.")

    _corrected: CorrectedMap | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        n = len(self.axes)
        if len(self.coordinates) != n or len(set(self.coordinates)) != n or len(set(self.axes)) != n:
            raise ValueError(f"needs {n} different axes and as many different names in `coordinates`")
        for name, values in (("scale", self.scale), ("offset", self.offset), ("matrix", self.matrix)):
            if values is not None and len(values) != n:
                raise ValueError(f"`{name}` has {len(values)} entries for {n} axes; give one for each")
        if self.matrix is not None:
            if (self.scale, self.skew, self.rotation) != (None, 0.0, 0.0):
                raise ValueError("has `matrix`, so `scale`, `skew` and `rotation` have no meaning; remove them")
            if any(len(row) != n for row in self.matrix):
                raise ValueError(f"every row of `matrix` needs {n} entries, one for each coordinate")
        is_turned = self.skew != 0.0 or self.rotation != 0.0
        if is_turned and n < 2:
            raise ValueError("`skew` and `rotation` need at least two coordinates")
        if isinstance(self.rotation, list) and (len(self.rotation) != 3 or n < 3):
            raise ValueError("`rotation` is one angle, or three angles for three coordinates or more")
        import numpy as np

        condition = float(np.linalg.cond(self.make_matrix()))
        if not condition < WORST_CONDITION:
            raise ValueError("maps different coordinates to the same positions; its matrix must have an inverse")
        return self

    @property
    def corrected(self) -> CorrectedMap | None:
        """The map of its axes if it is the frame of a corrected group: then positions are those without errors, which
        the map turns into positions of the real axes."""
        return self._corrected

    def with_errors(self, corrected: CorrectedMap) -> "FrameSpec":
        """The frame of a corrected group."""
        frame = self.model_copy()
        frame._corrected = corrected  # noqa: SLF001
        return frame

    def find_influences(self) -> "Matrix":
        """By how much each axis moves per unit of each coordinate at most, without signs: (axes, coordinates)."""
        import numpy as np

        influences = np.abs(self.make_matrix())
        return influences if self._corrected is None else influences + np.array(self._corrected.steepest)

    def make_matrix(self) -> "Matrix":
        """The matrix (axes, coordinates), before the units of the axes: rotation x skew x scale."""
        import numpy as np

        n = len(self.axes)
        if self.matrix is not None:
            return np.array(self.matrix, dtype=np.float64)
        matrix = np.diag(np.array(self.scale or [1.0] * n, dtype=np.float64))
        if self.skew:
            lean = np.eye(n)
            lean[0, 1] = tan(radians(self.skew))
            matrix = lean @ matrix
        angles = self.rotation if isinstance(self.rotation, list) else [0.0, 0.0, self.rotation]
        for (i, j), angle in zip(((1, 2), (2, 0), (0, 1)), angles, strict=True):
            if angle:
                turn = np.eye(n)
                turn[i, i] = turn[j, j] = cos(radians(angle))
                turn[j, i], turn[i, j] = sin(radians(angle)), -sin(radians(angle))
                matrix = turn @ matrix
        return matrix

    def make_offset(self, units: list[Unit]) -> "Matrix":
        """The positions of the axes at the origin, in their units."""
        import numpy as np

        offset = self.offset or [0] * len(self.axes)
        pairs = zip(offset, units, self.axes, strict=True)
        return np.array([float(parse_quantity(value, unit, axis)) for value, unit, axis in pairs])

    def find_positions(self, coordinates: list[float], units: list[Unit]) -> list[float]:
        """The positions of the axes at a point, in their units."""
        positions: Matrix = self.make_matrix() @ coordinates + self.make_offset(units)
        if self._corrected is not None:
            positions = self._corrected.turn(positions[None, :])[0]
        numbers: list[float] = positions.tolist()
        return numbers

    def find_coordinates(self, positions: "Matrix", units: list[Unit]) -> "Matrix":
        """The coordinates of positions (points, axes): the inverse map, for reports."""
        import numpy as np

        if self._corrected is not None:
            positions = self._corrected.straighten(positions)
        return np.asarray(np.linalg.solve(self.make_matrix(), (positions - self.make_offset(units)).T).T, np.float64)
