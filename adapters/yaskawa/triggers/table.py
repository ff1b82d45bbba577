"""The table of triggers in the controller: loaded before a step, and read with its stamps after it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil

from adapters.contract import ChunkInstants, HostInterval, SwitchedOutput
from adapters.yaskawa.common.arrays import ArrayTransfer, allocate_arrays, fill_arrays, read_elements
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.lines import LoadedStep, PartRelease, ProgramTriggers
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import EDGE_THREAD, FAR_TICKS, TABLE
from adapters.yaskawa.triggers.ring import RING, TriggerRing
from adapters.yaskawa.triggers.traits import TriggerTraits
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from orchestrator.clock.base import NS_PER_US, Clock
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import BudgetTerm

SPAN_TICKS = 2048  # of stamps for which the clock is estimated once
STAMP_DIGITS = 10  # of an element in an upload (PF)


FAR_COMMANDS = 24  # that may come between two looks whether the next trigger of a ring is near
SPARE_TICKS = 16  # from a change of the ring to the look that finds a trigger near


@dataclass(frozen=True, slots=True)
class _PlayedTable:
    """What is played. table: samples after XT0, by number; of a ring, of all that was released so far."""

    switches: ProgramTriggers
    table: list[int]
    step: LoadedStep
    ring: TriggerRing | None = None


class TriggerPlayer:
    """The triggers of the step that is loaded, or was last."""

    def __init__(self, device: SmcDevice, clock: Clock, options: YaskawaOptions, traits: TriggerTraits) -> None:
        self._device = device
        self._clock = clock
        self._traits = traits
        self._transfer = ArrayTransfer((TABLE,), traits.packet, traits.back, STAMP_DIGITS)
        self._options = options
        self._played: _PlayedTable | None = None
        self._next_end_ns = 0

    def forget(self) -> None:
        """Forget the last table: the controller may no longer have it."""
        self._played = None

    async def load(self, switches: ProgramTriggers, step: LoadedStep) -> None:
        """Load the table, read it back, and start its program, which waits for the gate. Raises `Refusal`."""
        table = self._make_values(switches.instants_ns, step, step.mapping)
        is_ring = switches.end_ns is not None
        session, output = self._device.session, switches.output
        size = RING if is_ring else len(table)
        try:
            await allocate_arrays(session, {TABLE: size}, self._transfer)
        except Refusal as refusal:
            text = f"the controller has no room for {size} triggers beside its other arrays"
            raise Refusal(refusal.code, text, "write a longer `every`, or divide the step") from None
        if table:
            await fill_arrays(session, [(TABLE, 0, table)], self._transfer)
        ring = TriggerRing(self._device, table) if is_ring else None
        self._played = _PlayedTable(switches, table, step, ring)
        wanted_values = {"XLO": output.number, "XLV": output.level, "XLH": output.active_ticks}
        wanted_values |= {"XRN": len(table), "XRI": 0, "XRV": output.level}
        if ring is not None:
            wanted_values |= {"XRM": RING - 1, "XRF": self._near_ticks, "XRE": 0}
        commands = [f"{name}={value}" for name, value in wanted_values.items()]
        entry = self._traits.find_label(turns=switches.turns, is_ring=is_ring)
        held_values = await session.set_and_read(commands, list(wanted_values), f"XQ {entry},{EDGE_THREAD}")
        for (name, value), held_value in zip(wanted_values.items(), held_values, strict=True):
            if held_value != value:
                raise Refusal("read-back", f"{name} reads back as {held_value:.0f}, not {value}", "try again")

    def _make_values(self, instants_ns: Sequence[int], step: LoadedStep, mapping: TickMapping) -> list[int]:
        """The samples after XT0 of instants after T0."""
        first, _ = self._options.begin_ticks(mapping.tick_ns, interleaved=True)
        return [round(mapping.to_ticks(step.t0_ns + instant_ns)) - first - step.ticks for instant_ns in instants_ns]

    @property
    def _near_ticks(self) -> int:
        """Samples before a trigger of a ring from which the program waits for it: a look comes in them for certain."""
        return FAR_TICKS + ceil(FAR_COMMANDS * self._options.decode_us * NS_PER_US / self._options.tick_ns)

    async def is_playing(self) -> bool:
        """Whether the program still plays the table, once no axis moves; a ring that is played to its end is ended."""
        played_table, session = self._played, self._device.session
        (is_running, index, end_index), _ = await session.read_numbers(f"_HX{EDGE_THREAD}", "XRI", "XRN")
        if played_table is not None and played_table.ring is not None and is_running and index == end_index:
            over_ns = played_table.step.t0_ns + (played_table.switches.end_ns or 0)
            if self._clock.now_ns() >= over_ns:
                await session.send_settings(["XRE=1"])
        return bool(is_running)

    # The chunks of a path

    async def load_part(self, instants: ChunkInstants, end_ns: int, mapping: TickMapping) -> BudgetTerm:
        """Load the triggers of the next chunk, which ends at `end_ns` after T0; return what the clock may be off at
        them. Raises `Refusal`."""
        played_table, ring = self._require_ring()
        step = played_table.step
        await ring.load_part(instants.first, self._make_values(instants.instants_ns, step, mapping))
        self._next_end_ns = end_ns
        bound_ns = mapping.bound_at_ns(step.t0_ns + end_ns)
        return BudgetTerm(name="clock", earliest_ns=-bound_ns, latest_ns=bound_ns)

    def plan_release(self) -> PartRelease | None:
        """What releases them; None if nothing changes."""
        index = self._require_ring()[1].find_release()
        return None if index is None else PartRelease(index, self._near_ticks + SPARE_TICKS)

    def take_part(self) -> None:
        """They are released."""
        played_table, ring = self._require_ring()
        ring.take_part()
        switches = replace(played_table.switches, end_ns=self._next_end_ns)
        self._played = replace(played_table, switches=switches)

    def _require_ring(self) -> tuple[_PlayedTable, TriggerRing]:
        if self._played is None or self._played.ring is None:
            raise Refusal("not-armed", "the controller plays no triggers that can be continued", "arm them first")
        return self._played, self._played.ring

    async def read(self, known: Mapping[str, int]) -> Mapping[str, SwitchedOutput]:
        """What the output of a path has done behind its first edges, whose number is in `known`. Raises `Refusal`."""
        played_table, ring = self._require_ring()
        name = played_table.switches.output.name
        first = known.get(name, 0)
        try:
            await ring.read_stamps()
        except SmcCommandRefused as refusal:
            raise _explain_missing_stamps(refusal) from None
        return {name: SwitchedOutput(self._find_edges(played_table, ring.stamps[first:], first))}

    async def take(self) -> Mapping[str, SwitchedOutput]:
        """What the output did, by the stamps of the program. Raises `Refusal`."""
        played_table = self._played
        if played_table is None:
            return {}
        try:
            stamps, following = await self._read_stamps(played_table)
        except SmcCommandRefused as refusal:
            raise _explain_missing_stamps(refusal) from None
        count = len(stamps)
        edges = self._find_edges(played_table, stamps, 0)
        # The program may have been halted between a stamp and its count: before OB, or after it.
        unknown = count < len(played_table.table) and following != played_table.table[count]
        return {played_table.switches.output.name: SwitchedOutput(edges, unknown)}

    async def _read_stamps(self, played: _PlayedTable) -> tuple[list[int], int | None]:
        """The stamps, and the element behind them, if there is one."""
        session, table = self._device.session, played.table
        (is_begun, index), _ = await session.read_numbers("XOK", "XRI")
        if not is_begun:
            return [], table[0] if table else None
        if played.ring is not None:
            await played.ring.read_stamps()
            return played.ring.stamps, await played.ring.read_next()
        (elements,) = await read_elements(session, [(TABLE, 0, len(table))], self._transfer)
        count = int(index)
        return elements[:count], elements[count] if count < len(table) else None

    def _find_edges(self, played: _PlayedTable, stamps: Sequence[int], first: int) -> list[HostInterval]:
        """The edges of stamps, from number `first` on."""
        mappings = self._find_mappings(played, stamps)
        return [
            self._find_edge(played, number, stamp, mapping)
            for number, (stamp, mapping) in enumerate(zip(stamps, mappings, strict=True), first)
        ]

    def _find_mappings(self, played: _PlayedTable, stamps: Sequence[int]) -> list[TickMapping]:
        """The estimate of the clock for each stamp: as it is known near it, at most half a span away."""
        mappings: dict[int, TickMapping] = {}
        for span in {stamp // SPAN_TICKS for stamp in stamps}:
            middle = span * SPAN_TICKS + SPAN_TICKS // 2
            mappings[span] = self._device.samples.find_mapping_near(middle) or played.step.mapping
        return [mappings[stamp // SPAN_TICKS] for stamp in stamps]

    def _find_edge(self, played: _PlayedTable, number: int, stamp: int, mapping: TickMapping) -> HostInterval:
        """The interval of an edge: after its wait had ended the stamp was read, during its sample, and OB came next,
        where threads alternate command by command after one of each other thread."""
        options, due = self._options, played.step.ticks + played.table[number]
        least_ns, most_ns = options.decode_min_us * NS_PER_US, options.decode_us * NS_PER_US
        earliest_ns = max(mapping.to_host_ns(stamp), mapping.to_host_ns(due) + least_ns) + least_ns
        latest_ns = mapping.to_host_ns(stamp + 1) + (1 + self._traits.beside) * most_ns
        bound_ns, late_ns = mapping.bound_at_ns(latest_ns), mapping.late_bound_at_ns(latest_ns)
        rises = played.switches.level_of(number)
        delay_ns = (options.output_on_us if rises else options.output_off_us) * NS_PER_US
        return HostInterval(earliest_ns - bound_ns, latest_ns + late_ns + delay_ns)


def _explain_missing_stamps(refusal: SmcCommandRefused) -> Refusal:
    return Refusal("no-stamps", f"the stamps of the triggers cannot be read: {refusal}", "")
