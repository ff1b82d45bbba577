"""The maps of a fleet's virtual axes to its real ones."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import islice, pairwise, product
from typing import Protocol

from orchestrator.model.axis_units import SoftLimits
from orchestrator.model.compensation import MOST_SLOPE, ROUNDING
from orchestrator.model.curved_map import CrystalEnergy, CurvedMap, Kinematics, SineBar
from orchestrator.model.frame import WORST_CONDITION, FrameSpec
from orchestrator.model.linear_map import (
    CorrectedMap,
    LinearMap,
    MapError,
    Matrix,
    SingularMap,
    chain_maps,
    find_condition,
    invert,
)
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.plugins import PluginError, UnknownPlugin, load_plugin
from orchestrator.model.problems import Problem
from orchestrator.model.units import Quantity, Unit, UnitError, convert_units, parse_quantity
from orchestrator.model.virtual_axes import VirtualAxis, VirtualGroup

VirtualMap = LinearMap | CurvedMap


@dataclass(frozen=True, slots=True)
class Pair:
    """Two real axes that carry one beam. middle, rack: its virtual axes, `group.axis`. real: both, in order. Lengths
    are in `unit`, that of both virtual axes.

    max_deviation: farther from `rack` = 0 than this, both are stopped. may_rack: how far the beam may be racked by a
    fault.
    """

    group: str
    middle: str
    rack: str
    real: tuple[str, str]
    unit: Unit
    max_deviation: Fraction
    may_rack: Fraction

    @property
    def jog_reach(self) -> Fraction:
        """How far one jog goes: so far apart a controller without its link takes the beam at most, which goes on to the
        end of its jog."""
        return self.may_rack - self.max_deviation

    def describe_rack(self, rack: float) -> str:
        """That it is racked, in words. rack: the position of its second virtual axis."""
        return (
            f"{self.group} is racked: {' and '.join(self.real)} are {abs(rack):.3g} {self.unit} apart, and at most "
            f"{float(self.max_deviation):g} are allowed (max_deviation)"
        )

    @property
    def square_remedy(self) -> str:
        """What to do when it is racked."""
        return f"find out why; then square it: `tutti axis move {self.rack}=0`"


def make_map(name: str, group: VirtualGroup, units: Mapping[str, Unit]) -> VirtualMap:
    """The map of group `name`. units: of its real axes. Raises `MapError`, `UnitError`."""
    if group.kind in _CURVED:
        return _make_curved(name, group, units)
    virtual_units = [group.axes[axis].unit for axis in group.order]
    if group.matrix is not None:
        matrix: Matrix = tuple(tuple(group.matrix[axis]) for axis in group.order)
    else:
        # The forms are in mm and rad, but for a pair, which may be of any axes of one kind.
        base = virtual_units[0] if group.pair is not None else Unit.MM
        sizes = [convert_units(Fraction(1), units[axis], base, axis) for axis in group.of]
        virtual_sizes = [_find_size(axis, group.axes[axis].unit, base) for axis in group.order]
        matrix = tuple(
            tuple(factor * real / size for factor, real in zip(row, sizes, strict=True))
            for row, size in zip(_LINEAR[group.kind](group), virtual_sizes, strict=True)
        )
    condition = find_condition(matrix)
    if not condition < WORST_CONDITION:
        raise SingularMap(_explain_singular(condition, "matrix" if group.matrix is not None else "places"))
    offsets = [
        parse_quantity(group.offset.get(axis, 0), unit) for axis, unit in zip(group.order, virtual_units, strict=True)
    ]
    if group.pair is not None:
        offsets[1] = -parse_quantity(group.pair.square, virtual_units[1])
    virtual = tuple(f"{name}.{axis}" for axis in group.order)
    return LinearMap(tuple(group.of), virtual, matrix, invert(matrix), tuple(offsets))


def _explain_singular(condition: float, field: str) -> str:
    return (
        f"different positions of its real axes give the same virtual ones (condition {condition:.3g}, at most "
        f"{WORST_CONDITION:g}); correct the {field}"
    )


def _find_size(axis: str, unit: Unit, base: Unit) -> Fraction:
    """The size of the unit of a virtual axis in `base`; in rad for the slopes of a table."""
    return convert_units(Fraction(1), unit, Unit.RAD if axis in ("pitch", "roll") else base, axis)


def _make_slit(group: VirtualGroup) -> Matrix:
    del group
    half = Fraction(1, 2)
    return (Fraction(1), Fraction(-1)), (half, half)


def _make_pair(group: VirtualGroup) -> Matrix:
    """The middle of both, and their difference."""
    difference, middle = _make_slit(group)
    return middle, difference


def _make_jacks(group: VirtualGroup) -> Matrix:
    """The height of each jack is height + pitch x y + roll x x, in mm and rad."""
    places = [[parse_quantity(end, Unit.MM) for end in corner] for corner in group.places or ()]
    heights: Matrix = tuple((Fraction(1), y, x) for x, y in places)
    if not find_condition(heights) < WORST_CONDITION:
        raise SingularMap("its jacks stand on one line, so a table on them can turn over; correct the places")
    return invert(heights)


def _make_rotation(group: VirtualGroup) -> Matrix:
    cosine, sine = _find_cosine(math.radians(group.angle or 0.0))
    return (cosine, sine), (-sine, cosine)


def _find_cosine(angle: float) -> tuple[Fraction, Fraction]:
    """Cosine and sine of an angle, rad. Rounded once; the inverse of a matrix is exact from then on."""
    cosine, sine = (Fraction(f"{value:.15f}") for value in (math.cos(angle), math.sin(angle)))
    return cosine, sine


_LINEAR: dict[str, Callable[[VirtualGroup], Matrix]] = {
    "slit": _make_slit,
    "jacks": _make_jacks,
    "rotation": _make_rotation,
    "pair": _make_pair,
}


# Curved ones


def _make_sine_bar(group: VirtualGroup) -> Kinematics:
    offset = parse_quantity(group.offset.get("angle", 0), group.axes["angle"].unit)
    angle = float(convert_units(offset, group.axes["angle"].unit, Unit.RAD, "angle"))
    return SineBar(float(parse_quantity(group.length or 0, Unit.MM)), angle)


def _make_energy(group: VirtualGroup) -> Kinematics:
    spacing = float(parse_quantity(group.spacing or 0, Unit.MM))
    return CrystalEnergy(spacing, math.radians(group.angle or 0.0), with_exit=len(group.of) > 1)


def _load_kinematics(group: VirtualGroup) -> Kinematics:
    """The kinematics of an installed package, with the parameters of a group. Raises `MapError`."""
    name = group.kinematics or ""
    try:
        make = load_plugin("tutti.kinematics", name, ("to_virtual", "to_real"))
        kinematics: Kinematics = make(dict(group.parameters))
    except (PluginError, UnknownPlugin) as error:
        raise MapError(str(error)) from None
    except Exception as error:
        text = f"kinematics {name} refuses its parameters: {type(error).__name__}: {error}; correct `parameters`"
        raise MapError(text) from None
    return kinematics


_CURVED: dict[str, Callable[[VirtualGroup], Kinematics]] = {
    "sine_bar": _make_sine_bar,
    "energy": _make_energy,
    "code": _load_kinematics,
}


def _make_curved(name: str, group: VirtualGroup, units: Mapping[str, Unit]) -> CurvedMap:
    kinematics = _CURVED[group.kind](group)
    label = f"kinematics {group.kinematics}" if group.kind == "code" else f"{name} ({group.kind})"
    if list(kinematics.axes) != list(group.order) or len(kinematics.of) != len(group.of):
        raise MapError(
            f"{label} has the axes {', '.join(kinematics.axes)} of {len(kinematics.of)} real ones; `axes` has "
            f"{', '.join(group.order)}, and `of` {len(group.of)}"
        )
    real_sizes = _convert_sizes(group.of, [units[axis] for axis in group.of], kinematics.of)
    virtual_units = [group.axes[axis].unit for axis in group.order]
    virtual_sizes = _convert_sizes(group.order, virtual_units, list(kinematics.axes.values()))
    virtual = tuple(f"{name}.{axis}" for axis in group.order)
    return CurvedMap(tuple(group.of), virtual, kinematics, real_sizes, virtual_sizes, label)


def _convert_sizes(axes: Sequence[str], units: Sequence[Unit], own: Sequence[str]) -> tuple[float, ...]:
    """The sizes of units of axes, in those of kinematics. Raises `UnitError`, `MapError`."""
    own_units = _parse_units(own)
    return tuple(
        float(convert_units(Fraction(1), unit, base, axis))
        for axis, unit, base in zip(axes, units, own_units, strict=True)
    )


def _parse_units(names: Sequence[str]) -> list[Unit]:
    """The units of kinematics. Raises `MapError`."""
    for name in names:
        if name not in list(Unit):
            raise MapError(f"the kinematics have the unit {name!r}, which is not known; known units: {', '.join(Unit)}")
    return list(map(Unit, names))


# Linear but for small errors


def _make_corrected(name: str, group: VirtualGroup, axes: Sequence["RealAxis"]) -> CorrectedMap:
    """The map of a corrected group, whose tables have no problems. axes: its real ones, in order. Raises `MapError`."""
    from orchestrator.model.tables.cross_errors import AxisErrors, CrossErrors

    _require_one_unit(group, axes)
    matrix = [[Fraction(int(row == column)) for column in range(len(axes))] for row in range(len(axes))]
    if group.squareness is not None:
        cosine, sine = _find_cosine(float(parse_quantity(group.squareness, Unit.RAD)))
        matrix[0][1], matrix[1][1] = sine, cosine
    columns = {axis: number for number, axis in enumerate(group.order)}
    parts = [
        AxisErrors(columns[table.axis], tuple(columns[axis] for axis in table.by), table.function)
        for table in group.tables.values()
    ]
    rows: Matrix = tuple(map(tuple, matrix))
    virtual = tuple(f"{name}.{axis}" for axis in group.order)
    zeros = (Fraction(0),) * len(axes)
    errors = CrossErrors(len(axes), tuple(parts))
    for axis, slopes in zip(group.order, errors.steepest.sum(axis=1).tolist(), strict=True):
        if slopes > MOST_SLOPE + ROUNDING:
            text = f"the tables of {axis} change its error by {slopes:.3g} of what the others move, and at most "
            raise MapError(
                f"{text}{MOST_SLOPE:g} is allowed, so that a position belongs to one place; check their units"
            )
    box = [find_range(axis) for axis in axes]
    return CorrectedMap(tuple(group.of), virtual, rows, invert(rows), zeros, errors, box)


def _require_one_unit(group: VirtualGroup, axes: Sequence["RealAxis"]) -> None:
    """Raise `MapError` unless all axes of a corrected group have one unit, and soft limits."""
    first = axes[0].unit
    for axis, real, config in zip(group.order, group.of, axes, strict=True):
        for of, unit in ((real, config.unit), (axis, group.axes[axis].unit)):
            if unit != first:
                text = f"{of} is in {unit}, and {group.of[0]} in {first}"
                raise MapError(f"{text}; all axes of `kind: corrected` have one unit")
        if config.soft_limits is None:
            raise MapError(f"{real} needs soft_limits, within which its errors are known; add them")


def _find_table_problems(name: str, group: VirtualGroup, find_axis: Callable[[str], "RealAxis"]) -> Iterator[Problem]:
    """What is wrong with the tables of a corrected group, by their rows."""
    real = dict(zip(group.order, group.of, strict=True))
    for table_name, table in group.tables.items():
        axes = [find_axis(real[axis]) for axis in table.by]
        limits = [None if axis.soft_limits is None else axis.soft_limits.in_unit(axis.unit) for axis in axes]
        for problem in table.find_problems(limits, axes[0].unit):
            yield Problem(("virtual", name, "tables", table_name, *problem.place), problem.text, problem.found)


# All of a fleet


class RealAxis(Protocol):
    """What a map needs to know of a real axis."""

    @property
    def unit(self) -> Unit: ...

    @property
    def wrap(self) -> Quantity | None: ...

    @property
    def soft_limits(self) -> SoftLimits | None: ...


class VirtualAxes:
    """All virtual axes of a fleet. maps: by group."""

    def __init__(self, groups: Mapping[str, VirtualGroup], find_axis: Callable[[str], RealAxis]) -> None:
        """groups: valid ones. find_axis: the real axis of a name."""
        self._groups = groups
        self._find_axis = find_axis
        self.maps: dict[str, VirtualMap] = {name: make_whole_map(name, groups, find_axis) for name in groups}

    @cached_property
    def frames(self) -> dict[str, FrameSpec]:
        """The groups in whose axes a path can be given, as frames: linear ones, with one unit of all axes."""
        frames: dict[str, FrameSpec] = {}
        for name, virtual_map in self.maps.items():
            units = {
                *map(self.unit_of, virtual_map.virtual),
                *(self._find_axis(axis).unit for axis in virtual_map.real),
            }
            if isinstance(virtual_map, LinearMap) and len(units) == 1 and name not in self.pairs:
                frame = FrameSpec(
                    axes=list(virtual_map.real),
                    coordinates=[split_name(axis)[1] for axis in virtual_map.virtual],
                    unit=units.pop(),
                    matrix=[list(map(float, row)) for row in virtual_map.inverse],
                    offset=[float(position) for position in virtual_map.origin],
                )
                is_corrected = isinstance(virtual_map, CorrectedMap)
                frames[name] = frame.with_errors(virtual_map) if is_corrected else frame
        return frames

    @cached_property
    def pairs(self) -> dict[str, Pair]:
        """The groups that are pairs."""
        pairs: dict[str, Pair] = {}
        for name, group in self._groups.items():
            if group.pair is not None:
                middle, rack = (f"{name}.{axis}" for axis in group.order)
                unit = group.axes[group.order[0]].unit
                most, may_rack = (
                    parse_quantity(value, unit) for value in (group.pair.max_deviation, group.pair.may_rack)
                )
                pairs[name] = Pair(name, middle, rack, (group.of[0], group.of[1]), unit, most, may_rack)
        return pairs

    @cached_property
    def pair_of(self) -> dict[str, Pair]:
        """By real axis, the pair that it is one of."""
        return {axis: pair for pair in self.pairs.values() for axis in pair.real}

    def name_whole(self, axis: str) -> str:
        """What commands name to home a real axis, or to jog it: of one of a pair, the virtual axis that moves both."""
        pair = self.pair_of.get(axis)
        return axis if pair is None else pair.middle

    @cached_property
    def groups_of(self) -> dict[str, list[str]]:
        """By controller, the groups that stand for axes of it."""
        groups: dict[str, list[str]] = {}
        for name, virtual_map in self.maps.items():
            for controller in dict.fromkeys(map(controller_of, virtual_map.real)):
                groups.setdefault(controller, []).append(name)
        return groups

    def find_pairs(self, controller: str) -> list[Pair]:
        """The pairs with an axis of a controller."""
        return [self.pairs[group] for group in self.groups_of.get(controller, ()) if group in self.pairs]

    def find(self, name: str) -> VirtualAxis:
        """The virtual axis `group.axis`, which exists."""
        group, axis = split_name(name)
        return self._groups[group].axes[axis]

    def check_speed(self, read_s: Callable[[], float]) -> None:
        """Check that code of users answers soon. read_s: a clock of this computer. Raises `MapError`."""
        for virtual_map in self.maps.values():
            if isinstance(virtual_map, CurvedMap):
                ranges = [find_range(self._find_axis(axis)) for axis in virtual_map.real]
                check_speed(virtual_map, ranges, read_s)

    def unit_of(self, name: str) -> Unit:
        """The unit of a virtual axis."""
        return self.find(name).unit

    def explain_beyond_limits(self, name: str, position: Fraction) -> str | None:
        """Why a position is outside the soft limits of a virtual axis itself; None if it is inside."""
        axis = self.find(name)
        if axis.soft_limits is None:
            return None
        low, high = axis.soft_limits.in_unit(axis.unit)
        if low <= position <= high:
            return None
        return (
            f"axis {name}: target {float(position):g} {axis.unit} is beyond its soft limits {float(low):g} to "
            f"{float(high):g} {axis.unit}"
        )

    def explain_target(self, name: str, value: Quantity) -> str | None:
        """Why a value of a file cannot be a position of a virtual axis; None if it can."""
        try:
            return self.explain_beyond_limits(name, parse_quantity(value, self.unit_of(name)))
        except UnitError as error:
            return str(error)


def list_real_axes(groups: Mapping[str, VirtualGroup], name: str) -> list[str]:
    """The real axes of a group, in the order of its map; those of virtual axes, for which it stands, come last."""
    inner = list_inner_groups(groups, name)
    real = [axis for axis in groups[name].of if split_name(axis)[0] not in inner]
    return [*real, *(axis for group in inner for axis in groups[group].of)]


def list_inner_groups(groups: Mapping[str, VirtualGroup], name: str) -> list[str]:
    """The groups for whose virtual axes a group stands."""
    owners = dict.fromkeys(split_name(axis)[0] for axis in groups[name].of)
    return [owner for owner in owners if owner in groups]


def make_whole_map(name: str, groups: Mapping[str, VirtualGroup], find_axis: Callable[[str], RealAxis]) -> VirtualMap:
    """The map of a group to real axes, through that of the groups for whose axes it stands. Raises `MapError`,
    `UnitError`."""
    group, inner = groups[name], list_inner_groups(groups, name)
    if group.kind == "corrected":
        if inner:
            raise MapError(f"it stands for axes of {inner[0]}, and its errors are of real axes; name these in `of`")
        return _make_corrected(name, group, [find_axis(axis) for axis in group.of])
    units: dict[str, Unit] = {}
    for axis in group.of:
        owner, axis_name = split_name(axis)
        units[axis] = groups[owner].axes[axis_name].unit if owner in groups else find_axis(axis).unit
    whole_map = make_map(name, group, units)
    if not inner:
        return whole_map
    linear_maps: list[LinearMap] = []
    for owner in inner:
        inner_map = make_whole_map(owner, groups, find_axis)
        if not isinstance(inner_map, LinearMap) or isinstance(inner_map, CorrectedMap):
            kind = "corrected" if isinstance(inner_map, CorrectedMap) else "curved"
            raise MapError(f"it stands for axes of {owner}, which is {kind}; name real axes in `of`")
        left_out = [axis for axis in inner_map.virtual if axis not in group.of]
        if left_out:
            raise MapError(f"it stands for axes of {owner}, but not for {left_out[0]}; name all of them in `of`")
        linear_maps.append(inner_map)
    if not isinstance(whole_map, LinearMap):
        raise MapError(f"it is curved, and stands for axes of {inner[0]}; name real axes in `of`")
    return chain_maps(whole_map, linear_maps)


# What is wrong with them

SAMPLES = 125  # places of its real axes, at which a map is tried
SHARES = (0.5, 0.02, 0.98, 0.26, 0.74)  # of the range of an axis
SLOWEST_S = 0.002  # an answer of code, the quickest of some: states take many of them
INVERSE_ERROR = 1e-7  # of a position, or of 1 in its unit if that is more
LINE_STEPS = 100  # along each axis, between which a corner is looked for
LEAST_CHANGE = 0.02  # of the steepest derivative between two of them, that is looked into
BISECTIONS = 10  # a smooth derivative changes by a thousandth of that then; numeric ones are not finer


def find_virtual_problems(groups: Mapping[str, VirtualGroup], find_axis: Callable[[str], RealAxis]) -> list[Problem]:
    """What is wrong with virtual axes beside their names. find_axis: raises `ValueError` for an unknown name."""
    nested_pairs = [problem for name in groups for problem in _find_nested_pairs(name, groups)]
    if nested_pairs:
        return nested_pairs
    problems = [problem for name in groups for problem in _find_problems(name, groups, find_axis)]
    return [*problems, *_find_shared_pairs(groups)]


def _find_nested_pairs(name: str, groups: Mapping[str, VirtualGroup]) -> Iterator[Problem]:
    """A pair of virtual axes, or virtual axes of a pair."""
    inner = list_inner_groups(groups, name)
    pair = next((owner for owner in (name, *inner) if groups[owner].pair is not None), None)
    if pair is not None and inner:
        text = "it is a pair, of two real axes" if pair == name else f"{pair} is a pair, which moves by its own axes"
        yield Problem(("virtual", name, "of"), f"{text}; name real axes in `of`")


def _find_shared_pairs(groups: Mapping[str, VirtualGroup]) -> Iterator[Problem]:
    """A real axis of a pair that another group has too, whose moves would take it away from its partner."""
    for name, group in groups.items():
        for pair, paired_group in groups.items():
            shared_axis = next((axis for axis in group.of if axis in paired_group.of), None)
            if paired_group.pair is not None and pair != name and shared_axis is not None:
                text = f"{shared_axis} is one of the pair {pair}, and does not move without the other; take it out of"
                yield Problem(("virtual", name, "of"), f"{text} `of`", shared_axis)


def _find_problems(
    name: str, groups: Mapping[str, VirtualGroup], find_axis: Callable[[str], RealAxis]
) -> Iterator[Problem]:
    path, inner = ("virtual", name, "of"), list_inner_groups(groups, name)
    deep_group = next((owner for owner in inner if list_inner_groups(groups, owner)), None)
    if deep_group is not None:
        chain = (
            f"{name} stands for axes of {deep_group}, and that for axes of {list_inner_groups(groups, deep_group)[0]}"
        )
        yield Problem(path, f"{chain}; name axes of the latter, or real ones, in `of`")
        return
    real_axes = list_real_axes(groups, name)
    double_axis = next((axis for axis in real_axes if real_axes.count(axis) > 1), None)
    if double_axis is not None:
        yield Problem(path, f"it stands for {double_axis} twice, also by virtual axes; name it once")
        return
    try:
        axes = {axis: find_axis(axis) for axis in real_axes}
        table_problems = list(_find_table_problems(name, groups[name], find_axis))
        if table_problems:
            yield from table_problems
            return
        whole_map = make_whole_map(name, groups, find_axis)
        for axis, config in axes.items():
            if config.wrap is not None:
                text = f"axis {axis} wraps, so its position is not unique; virtual axes need axes that do not wrap"
                yield Problem(path, text, axis)
        if isinstance(whole_map, CurvedMap):
            check_curved(whole_map, [find_range(axes[axis]) for axis in whole_map.real])
    except (MapError, UnitError) as error:
        yield Problem(("virtual", name), str(error))
    except (KeyError, ValueError):
        return  # a name that is reported with the others


def find_range(axis: RealAxis) -> tuple[float, float]:
    """Where a real axis may be, in its unit; a guess without soft limits."""
    if axis.soft_limits is None:
        return (-1.0, 1.0)
    low, high = axis.soft_limits.in_unit(axis.unit)
    return (float(low), float(high))


def make_plain_map(kinematics: Kinematics) -> CurvedMap:
    """The map of kinematics in their own units. Raises `MapError`."""
    real, virtual = tuple(f"real {number}" for number in range(len(kinematics.of))), tuple(kinematics.axes)
    _parse_units([*kinematics.of, *kinematics.axes.values()])
    if len(real) != len(virtual):
        raise MapError(f"{len(virtual)} virtual axes of {len(real)} real ones; give as many of each")
    sizes = (1.0,) * len(real)
    return CurvedMap(real, virtual, kinematics, sizes, sizes, type(kinematics).__name__)


def check_curved(virtual_map: CurvedMap, ranges: Sequence[tuple[float, float]]) -> None:
    """Check at places of its real axes that a map can be used: it has an inverse, which is its own, and is smooth.
    ranges: of the real axes, in their units. Raises `MapError`."""
    places = find_answered_places(virtual_map, ranges)
    for real in places:
        _check_inverse(virtual_map, real)
        _check_condition(virtual_map, real)
    _check_smooth(virtual_map, places[0], ranges)


def find_answered_places(virtual_map: CurvedMap, ranges: Sequence[tuple[float, float]]) -> list[list[float]]:
    """Places of the real axes at which a map has an answer. Raises `MapError` where it has none."""
    grid = [
        [low + share * (high - low) for share, (low, high) in zip(shares, ranges, strict=True)]
        for shares in islice(product(SHARES, repeat=len(ranges)), SAMPLES)
    ]
    first_error: MapError | None = None
    places: list[list[float]] = []
    for real in grid:
        try:
            virtual_map.observe(real)
        except MapError as error:
            first_error = first_error or error
        else:
            places.append(real)
    if first_error is not None and not places:
        raise first_error
    return places


def check_speed(virtual_map: CurvedMap, ranges: Sequence[tuple[float, float]], read_s: Callable[[], float]) -> None:
    """Check that a map, which is code of users, answers soon. read_s: a clock of this computer. Raises `MapError`."""
    real = find_answered_places(virtual_map, ranges)[0]
    durations: list[float] = []
    for _ in range(5):
        begun_s = read_s()
        virtual_map.to_real([Fraction(value) for value in virtual_map.observe(real)])
        durations.append((read_s() - begun_s) / 2)
    if min(durations) > SLOWEST_S:
        text = f"{virtual_map.label}: its code takes {min(durations) * 1000:.3g} ms for an answer; at most "
        raise MapError(f"{text}{SLOWEST_S * 1000:g} ms: states and plans take many of them")


def _check_inverse(virtual_map: CurvedMap, real: list[float]) -> None:
    virtual = virtual_map.observe(real)
    found_positions = [float(value) for value in virtual_map.to_real(list(map(Fraction, virtual)))]
    if any(
        abs(first - second) > INVERSE_ERROR * max(1.0, abs(first))
        for first, second in zip(real, found_positions, strict=True)
    ):
        text = f"{_show(real)} is {_show(virtual)}, and that is {_show(found_positions)}"
        raise MapError(f"{virtual_map.label} is not its own inverse: {text}")


def _check_condition(virtual_map: CurvedMap, real: list[float]) -> None:
    condition = find_condition(virtual_map.find_rows(real))
    if not condition < WORST_CONDITION:
        raise SingularMap(f"at {_show(real)} {_explain_singular(condition, 'parameters, or the range of its axes')}")


def _check_smooth(virtual_map: CurvedMap, middle: list[float], ranges: Sequence[tuple[float, float]]) -> None:
    """Look for a jump of the derivative on a line along each axis: however near two places are, it stays."""
    for number, (low, high) in enumerate(ranges):

        def find_row(value: float, number: int = number) -> list[float] | None:
            try:
                rows = virtual_map.find_rows([*middle[:number], value, *middle[number + 1 :]])
            except MapError:
                return None  # outside of its domain
            return [factor for row in rows for factor in row]

        places = [low + (high - low) * step / LINE_STEPS for step in range(LINE_STEPS + 1)]
        rows = [find_row(value) for value in places]
        steepest = max((abs(factor) for row in rows if row is not None for factor in row), default=0.0)
        for (begin, end), (row, next_row) in zip(pairwise(places), pairwise(rows), strict=True):
            if row is None or next_row is None or _find_change(row, next_row) < LEAST_CHANGE * steepest:
                continue
            corner = _find_corner(find_row, (begin, row), (end, next_row))
            if corner is not None:
                corner_place = [*middle[:number], corner, *middle[number + 1 :]]
                raise MapError(f"{virtual_map.label} is not smooth: its derivative jumps at {_show(corner_place)}")


def _find_corner(
    find_row: Callable[[float], list[float] | None], low: tuple[float, list[float]], high: tuple[float, list[float]]
) -> float | None:
    """Where the derivative jumps between two places, given with it; None: nowhere, or there is no answer between."""
    first_change = _find_change(low[1], high[1])
    for _ in range(BISECTIONS):
        middle = (low[0] + high[0]) / 2
        row = find_row(middle)
        if row is None:
            return None
        if _find_change(low[1], row) > _find_change(row, high[1]):
            high = (middle, row)
        else:
            low = (middle, row)
    return low[0] if _find_change(low[1], high[1]) > first_change / 2 else None


def _find_change(first: Sequence[float], second: Sequence[float]) -> float:
    """By how much a derivative changes at most."""
    return max(abs(first_part - second_part) for first_part, second_part in zip(first, second, strict=True))


def _show(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.9g}" for value in values) + ")"
