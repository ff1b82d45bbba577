"""What the resident program executes in a step: independent moves by registers, a contour, or a path in chunks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

from adapters.contract import Lowered, PathChunk
from adapters.yaskawa.common import arrays, lines
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import TAIL, array_name, axis_letters, entry_label
from adapters.yaskawa.shapes.contour import Contour, axis_increments
from adapters.yaskawa.shapes.course_records import ChunkRecords, RecordMaker, RingRoom
from adapters.yaskawa.shapes.model import RAMP_UNIT, SPEED_UNIT
from adapters.yaskawa.shapes.trapezoid import RegisterTrapezoid
from orchestrator.model.profile import Profile

CONTOUR_EXCHANGES = 8  # DC, XN, XM, XDT, their verification and the short array, in addition to an independent move
WHOLE_MASK = (1 << 14) - 1  # of an array as large as they can be


@dataclass(frozen=True, slots=True)
class YaskawaAxisMove:
    """One axis's move.

    index: 0 is X.
    start, end: absolute commanded positions, counts.
    samples: from the begin to the last commanded position, 0 for an axis at rest."""

    axis: str
    index: int
    start: int
    end: int
    samples: int


@dataclass(frozen=True, slots=True)
class YaskawaLowered(Lowered):
    """A lowered step with what arming needs beyond the contract. at_once: behind the present step, it begins at no
    sample of its own, but as soon as that one has ended."""

    moves: tuple[YaskawaAxisMove, ...]
    mask: int
    load: "MoveLoad"
    waits: lines.ProgramWait | None = None
    drives: lines.ProgramOutput | None = None
    switches: lines.ProgramTriggers | None = None
    at_once: bool = False

    @property
    def moving_axes(self) -> tuple[YaskawaAxisMove, ...]:
        """The axes that move."""
        return tuple(move for move in self.moves if move.samples)


class SamplePlace(NamedTuple):
    """How a move lies to the samples. phase: samples from T0 to the sample in which it begins. tick_ns: of a sample."""

    phase: float
    tick_ns: float


class AxisTiming(NamedTuple):
    """The motion of one axis. length: samples to its end; samples: whole ones, 0 for an axis at rest. error_counts: the
    largest distance to the plan. brake_ns: the longest time of a stop."""

    length: float
    samples: int
    error_counts: float
    brake_ns: float


AT_REST = AxisTiming(0.0, 0, 0.0, 0.0)


class ArrayLoader(Protocol):
    """Loads arrays into the controller."""

    async def load_arrays(self, contents: Mapping[str, Sequence[int]], packets: arrays.ArrayTransfer) -> None:
        """Allocate arrays, fill them, and verify their contents. Raises `Refusal`."""
        ...

    async def load_first(self, records: ChunkRecords, room: RingRoom) -> None:
        """Allocate the arrays of a path, and load its first chunk. Raises `Refusal`."""
        ...


class MoveLoad(Protocol):
    """What the program executes in a step, and how it is loaded."""

    @property
    def registers(self) -> Mapping[str, Mapping[int, int]]:
        """The values of axes by command."""
        ...

    @property
    def register_values(self) -> Mapping[str, Mapping[int, int]]:
        """Those of them that read back as they were loaded."""
        ...

    @property
    def variables(self) -> dict[str, int]:
        """The variables of the program, by name."""
        ...

    @property
    def commands(self) -> tuple[str, ...]:
        """The commands that load registers and variables."""
        ...

    @property
    def display(self) -> tuple[str, ...]:
        """What is loaded, for display."""
        ...

    @property
    def contour(self) -> Contour | None:
        """The contour that it plays, if it does."""
        ...

    @property
    def course(self) -> "CourseLoad | None":
        """The path in chunks, if it is one."""
        ...

    @property
    def fits_beside(self) -> bool:
        """Whether the controller can hold it beside another move, and another move beside it."""
        ...

    def label(self, mask: int) -> str:
        """Return the entry of the program for the axes of `mask`."""
        ...

    def begin_words(self, mask: int) -> str:
        """Return what begins the axes of `mask`, for display."""
        ...

    async def upload(self, loader: ArrayLoader, lowered: YaskawaLowered, place: SamplePlace) -> YaskawaLowered:
        """Load the arrays, of a move at rest; return the move as it is loaded. Raises `Refusal`."""
        ...

    def timing(self, axis: str, index: int, profile: Profile, tick_ns: float) -> AxisTiming:
        """Return the motion of an axis, for samples of `tick_ns`. index: 0 is X."""
        ...

    def loading_ns(self, options: YaskawaOptions, tick_ns: float) -> int:
        """Return how much longer arming takes with its arrays, ns."""
        ...


@dataclass(frozen=True, slots=True)
class RegisterLoad:
    """Independent moves. ends, shapes: by index of the axis."""

    ends: Mapping[int, int]
    shapes: Mapping[int, RegisterTrapezoid]

    @property
    def register_values(self) -> dict[str, dict[int, int]]:
        """Return the values of axes by command, for verification."""
        shapes = self.shapes.items()
        return {
            "SP": {index: shape.speed for index, shape in shapes},
            "AC": {index: shape.up for index, shape in shapes},
            "DC": {index: shape.down for index, shape in shapes},
        }

    @property
    def commands(self) -> tuple[str, ...]:
        """Return the commands that load the registers; axes without motion are not touched."""
        if not self.ends:
            return ()
        return tuple(f"{command} {format_fields(values)}" for command, values in self.registers.items())

    @property
    def registers(self) -> Mapping[str, Mapping[int, int]]:
        """Return the values of axes by command, the ends included."""
        return {"PA": self.ends, **self.register_values}

    @property
    def display(self) -> tuple[str, ...]:
        """Return the commands."""
        return self.commands

    @property
    def variables(self) -> dict[str, int]:
        """Return nothing: the program reads no variable."""
        return {}

    @property
    def contour(self) -> None:
        """It has none."""

    @property
    def course(self) -> None:
        """It has none."""

    @property
    def fits_beside(self) -> bool:
        """It does: the registers of a following move are kept in variables."""
        return True

    def label(self, mask: int) -> str:
        """Return the entry of its program."""
        return entry_label(mask, contour=False)

    def begin_words(self, mask: int) -> str:
        """Return the command that begins it."""
        return f"BG{axis_letters(mask)}"

    async def upload(self, loader: ArrayLoader, lowered: YaskawaLowered, place: SamplePlace) -> YaskawaLowered:
        """Upload nothing."""
        del loader, place
        return lowered

    def timing(self, axis: str, index: int, profile: Profile, tick_ns: float) -> AxisTiming:
        """Return the timing of the shape. A stop brakes with the move's own DC, which a gentle move sets below the
        axis's limit."""
        del axis, profile
        shape = self.shapes.get(index)
        if shape is None:
            return AT_REST
        brake_ns = shape.speed / shape.down * RAMP_UNIT / SPEED_UNIT * tick_ns
        return AxisTiming(shape.length, shape.whole_samples, shape.path_error_counts, brake_ns)

    def loading_ns(self, options: YaskawaOptions, tick_ns: float) -> int:
        """Return 0."""
        del options, tick_ns
        return 0


@dataclass(frozen=True, slots=True)
class ContourLoad:
    """A contour. profiles: by index of the axis. brakes: its DC, for a stop. packets: how its arrays are
    transferred."""

    contour: Contour
    profiles: Mapping[int, Profile]
    ends: Mapping[int, int]
    brakes: Mapping[int, int]
    packets: arrays.ArrayTransfer = arrays.DEFAULT_TRANSFER

    @property
    def register_values(self) -> dict[str, dict[int, int]]:
        """Return the values of axes by command, for verification."""
        return {"DC": dict(self.brakes)}

    def array_contents(self, phase: float, tick_ns: float) -> dict[str, list[int]]:
        """Return the contents of the arrays for a start `phase` samples after T0, with samples of `tick_ns`."""
        contents = {
            array_name(index): axis_increments(profile, self.ends[index], self.contour, phase, tick_ns)
            for index, profile in self.profiles.items()
        }
        return contents | ({TAIL: list(self.contour.tail)} if self.contour.tail else {})

    @property
    def variables(self) -> dict[str, int]:
        """Return the program's variables."""
        contour = self.contour
        # The last record of full length begins the end; the mask keeps every index.
        variables = {"XN": contour.records - 1, "XTB": contour.records - 1, "XV": contour.records}
        return {**variables, "XM": contour.record_count, "XDT": contour.interval, "XW": WHOLE_MASK}

    @property
    def display(self) -> tuple[str, ...]:
        """Return the contour in words, and its commands."""
        names = ", ".join(array_name(index) for index in self.profiles)
        tail = f", then one each of {', '.join(str(1 << n) for n in self.contour.tail)}" if self.contour.tail else ""
        return (
            f"contour: {self.contour.records} records of {1 << self.contour.interval} samples{tail}",
            f"DC {format_fields(self.brakes)}",
            f"QD {names}: {self.contour.record_count} increments each",
        )

    @property
    def registers(self) -> Mapping[str, Mapping[int, int]]:
        """Return the values of axes by command."""
        return self.register_values

    @property
    def commands(self) -> tuple[str, ...]:
        """Return the commands that load the ramp of a stop, and the variables."""
        return (f"DC {format_fields(self.brakes)}", *(f"{name}={value}" for name, value in self.variables.items()))

    @property
    def course(self) -> "CourseLoad | None":
        """The path in chunks of which it is the first one, if it is."""
        return None

    @property
    def fits_beside(self) -> bool:
        """It does not: the program holds one contour at a time."""
        return False

    def label(self, mask: int) -> str:
        """Return the entry of its program."""
        return entry_label(mask, contour=True)

    def begin_words(self, mask: int) -> str:
        """Return the commands that execute it."""
        return f"CD of {axis_letters(mask)}"

    async def upload(self, loader: ArrayLoader, lowered: YaskawaLowered, place: SamplePlace) -> YaskawaLowered:
        """Upload its arrays."""
        await loader.load_arrays(self.array_contents(place.phase, place.tick_ns), self.packets)
        return lowered

    def timing(self, axis: str, index: int, profile: Profile, tick_ns: float) -> AxisTiming:
        """Return the timing of the plan. Only its last count is delayed to the end of a record."""
        if index not in self.ends:
            return AT_REST
        planned_samples, samples = profile.duration_s * 1e9 / tick_ns, self.ends[index]
        return AxisTiming(
            planned_samples if abs(samples - planned_samples) <= 1.0 else samples,
            samples,
            1.0 + self.contour.sag_counts[axis],
            profile.peak_velocity * tick_ns / self.brakes[index] * RAMP_UNIT * tick_ns * 1e-9,
        )

    def loading_ns(self, options: YaskawaOptions, tick_ns: float) -> int:
        """Return how much longer arming takes than for an independent move."""
        if isinstance(self.packets, arrays.SlowArrayTransfer):
            return (
                self.packets.load_duration_ns(self.array_contents(0.0, tick_ns))
                + CONTOUR_EXCHANGES * self.packets.exchange_ns
            )
        longest_s = tick_ns * 1e-9 * (1 << self.contour.interval)
        digits = [len(str(round(profile.peak_velocity * longest_s) + 2)) for profile in self.profiles.values()]
        return (arrays.count_exchanges(self.contour.record_count, digits) + CONTOUR_EXCHANGES) * options.exchange_ns


@dataclass(frozen=True, slots=True)
class CourseLoad(ContourLoad):
    """The first chunk of a path. Its contour is as for a start at T0 exactly, until the records are made for the sample
    in which it begins: of the chunk that is released."""

    chunk: PathChunk = field(kw_only=True)
    maker: RecordMaker = field(kw_only=True)
    records: ChunkRecords = field(kw_only=True)

    @property
    def variables(self) -> dict[str, int]:
        """Return the program's variables of the chunk."""
        ring = {"XN": self.records.end, "XDT": self.maker.interval, "XW": self.maker.room.ring - 1}
        return {**ring, **self.records.tail_variables(self.maker.room)}

    @property
    def course(self) -> "CourseLoad":
        """It is one."""
        return self

    async def upload(self, loader: ArrayLoader, lowered: YaskawaLowered, place: SamplePlace) -> YaskawaLowered:
        """Make the records, and upload them."""
        records = self.maker.make_first(self.chunk, place.phase, place.tick_ns)
        await loader.load_first(records, self.maker.room)
        return self.follow_records(lowered, records)

    def follow_records(self, lowered: YaskawaLowered, records: ChunkRecords) -> YaskawaLowered:
        """Return the lowered path as far as it is released: to the end of the tail of `records`."""
        samples = records.samples(self.maker.interval)
        contour = replace(
            self.contour,
            records=records.end + records.full,
            tail=records.short,
            ends=dict.fromkeys(self.contour.ends, samples),
        )
        return replace(
            lowered,
            durations_s=dict.fromkeys(lowered.durations_s, records.stop_s),
            moves=tuple(replace(move, end=records.targets[move.index], samples=samples) for move in lowered.moves),
            load=replace(self, contour=contour, records=records),
        )


def format_fields(values: Mapping[int, int]) -> str:
    """Format values by axis index as the fields of a command: `100,,-5`."""
    return ",".join(str(values[index]) if index in values else "" for index in range(max(values) + 1))
