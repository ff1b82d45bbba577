"""The table of triggers in the controller: loaded before a step, and read with its stamps after it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from adapters.contract import HostInterval, SwitchedOutput
from adapters.yaskawa.common.arrays import ArrayTransfer, allocate_arrays, fill_arrays, read_elements
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.lines import LoadedStep, ProgramTriggers
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import EDGE_THREAD, TABLE
from adapters.yaskawa.triggers.traits import TriggerTraits
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal

SPAN_TICKS = 2048  # of stamps for which the clock is estimated once
STAMP_DIGITS = 10  # of an element in an upload (PF)


@dataclass(frozen=True, slots=True)
class _PlayedTable:
    switches: ProgramTriggers
    table: list[int]
    step: LoadedStep


class TriggerPlayer:
    """The triggers of the step that is loaded, or was last."""

    def __init__(self, device: SmcDevice, options: YaskawaOptions, traits: TriggerTraits) -> None:
        self._device = device
        self._traits = traits
        self._transfer = ArrayTransfer((TABLE,), traits.packet, traits.back, STAMP_DIGITS)
        self._options = options
        self._played: _PlayedTable | None = None

    def forget(self) -> None:
        """Forget the last table: the controller may no longer have it."""
        self._played = None

    async def load(self, switches: ProgramTriggers, step: LoadedStep) -> None:
        """Load the table, read it back, and start its program, which waits for the gate. Raises `Refusal`."""
        first, _ = self._options.begin_ticks(step.mapping.tick_ns, interleaved=True)
        table = switches.make_table(step.ticks, first, step.t0_ns, step.mapping)
        session, output = self._device.session, switches.output
        try:
            await allocate_arrays(session, {TABLE: len(table)}, self._transfer)
        except Refusal as refusal:
            text = f"the controller has no room for {len(table)} triggers beside its other arrays"
            raise Refusal(refusal.code, text, "write a longer `every`, or divide the step") from None
        await fill_arrays(session, [(TABLE, 0, table)], self._transfer)
        self._played = _PlayedTable(switches, table, step)
        wanted_values = {"XLO": output.number, "XLV": output.level, "XLH": output.active_ticks}
        wanted_values |= {"XRN": len(table), "XRI": 0, "XRV": output.level}
        commands = [f"{name}={value}" for name, value in wanted_values.items()]
        entry = self._traits.level_label if switches.turns else self._traits.pulse_label
        held_values = await session.set_and_read(commands, list(wanted_values), f"XQ {entry},{EDGE_THREAD}")
        for (name, value), held_value in zip(wanted_values.items(), held_values, strict=True):
            if held_value != value:
                raise Refusal("read-back", f"{name} reads back as {held_value:.0f}, not {value}", "try again")

    async def is_playing(self) -> bool:
        """Whether the program still plays the table."""
        (is_running,), _ = await self._device.session.read_numbers(f"_HX{EDGE_THREAD}")
        return bool(is_running)

    async def take(self) -> Mapping[str, SwitchedOutput]:
        """What the output did, by the stamps of the program. Raises `Refusal`."""
        played_table, session = self._played, self._device.session
        if played_table is None:
            return {}
        try:
            (is_begun, index), _ = await session.read_numbers("XOK", "XRI")
            held_table = played_table.table
            if is_begun:
                (held_table,) = await read_elements(session, [(TABLE, 0, len(held_table))], self._transfer)
        except SmcCommandRefused as refusal:
            raise Refusal("no-stamps", f"the stamps of the triggers cannot be read: {refusal}", "") from None
        count = int(index) if is_begun else 0
        mappings = self._find_mappings(played_table, held_table[:count])
        edges = [self._find_edge(played_table, number, held_table[number], mappings[number]) for number in range(count)]
        # The program may have been halted between a stamp and its count: before OB, or after it.
        unknown = count < len(held_table) and held_table[count] != played_table.table[count]
        return {played_table.switches.output.name: SwitchedOutput(edges, unknown)}

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
