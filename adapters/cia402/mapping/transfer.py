"""The PDOs of a drive, mapped as planned and read back. What it cannot map shows in its answers."""

from dataclasses import replace

from adapters.cia402.canopen import words
from adapters.cia402.canopen.objects import DictionaryObject, read_mapping_entry
from adapters.cia402.canopen.pdos import PdoLayout, PdoMapping
from adapters.cia402.canopen.sdo import SdoAborted, SdoClient
from adapters.cia402.canopen.words import FIXED, NOT_THERE, READ_ONLY, WRONG_STATE, abort_text
from adapters.cia402.mapping.layout import PdoTraits, UnsuitablePdos, plan_layout
from adapters.cia402.mapping.required import PdoNeeds, list_all_pdos
from orchestrator.model.errors import ControllerFault, TuttiError

_OFF = 1 << 31
_COB_MASK = 0x7FF


class MappingNotAllowed(TuttiError):
    """The drive accepts no mapping in its present NMT state."""


class _OtherTraits(TuttiError):
    """The drive has other traits than were planned with."""

    def __init__(self, traits: PdoTraits) -> None:
        super().__init__()
        self.traits = traits


def parameter_values(pdo: PdoMapping, node: int) -> list[tuple[DictionaryObject, int]]:
    """Return the objects that describe a PDO, each with its required value."""
    times = [(obj, value) for obj, value in _list_times(pdo) if value]
    return [
        (_parameter_object(pdo, 1, 32), pdo.function + node),
        (_parameter_object(pdo, 2, 8), pdo.kind),
        *times,
        (_mapping_object(pdo, 0, 8), len(pdo.carries)),
        *(
            (_mapping_object(pdo, number, 32), carried_object.mapping_entry)
            for number, carried_object in enumerate(pdo.carries, start=1)
        ),
    ]


def pdo_value(obj: DictionaryObject, value: int) -> int:
    """Return the part of a value that `parameter_values` states: a COB-ID has further flags (no remote request)."""
    return value & (_OFF | _COB_MASK) if obj.sub == 1 and obj.name.startswith("COB-ID") else value


class PdoMapper:
    """Map the PDOs of one drive, at each of its connections. needs: what the fleet file asks of them."""

    def __init__(self, needs: PdoNeeds) -> None:
        self.needs = needs
        self._traits = PdoTraits()

    async def map_all(self, sdo: SdoClient, node: int, name: str) -> tuple[PdoLayout, bool]:
        """Map the PDOs if any differs from what is needed, and read them back; return them, and whether any differed.
        Raises `MappingNotAllowed`, `ControllerFault`.

        A drive that lacks something is compared with what it could map at the last connection: otherwise it would
        seem to have lost its mapping by a restart.
        """
        try:
            layout = plan_layout(self.needs, self._traits)
            if self._traits != PdoTraits() and await _are_mapped(sdo, node, layout):
                return layout, False
            self._traits, is_changed = PdoTraits(), False
            while True:
                try:
                    layout = plan_layout(self.needs, self._traits)
                    is_changed |= await self._map_layout(sdo, node, name, layout)
                except _OtherTraits as error:
                    self._traits, is_changed = error.traits, True
                else:
                    return layout, is_changed
        except UnsuitablePdos as error:
            raise ControllerFault("pdo-mapping", f"{name}: {error.text}", error.remedy) from None

    async def _map_layout(self, sdo: SdoClient, node: int, name: str, layout: PdoLayout) -> bool:
        """Map the PDOs that differ; return whether any did."""
        is_changed = False
        for pdo in layout.pdos:
            if not await _is_mapped(sdo, node, pdo):
                is_changed = True
                await _PdoWriter(sdo, node, name, self._traits).map_pdo(pdo)
                await _require_mapped(sdo, node, name, pdo)
        return is_changed


async def _are_mapped(sdo: SdoClient, node: int, layout: PdoLayout) -> bool:
    for pdo in layout.pdos:
        if not await _is_mapped(sdo, node, pdo):
            return False
    return True


async def _require_mapped(sdo: SdoClient, node: int, name: str, pdo: PdoMapping) -> None:
    if not await _is_mapped(sdo, node, pdo):
        objects_text = ", ".join(str(carried_object) for carried_object in pdo.carries)
        raise ControllerFault(
            "pdo-mapping",
            f"{name} has accepted a mapping for {pdo.title} and does not store it: wanted {objects_text}",
            "is another master on the bus? Is the mapping fixed? See the drive's manual",
        )


async def _is_mapped(sdo: SdoClient, node: int, pdo: PdoMapping) -> bool:
    parameter, count = _parameter_object(pdo, 1, 32), _mapping_object(pdo, 0, 8)
    try:
        cob = await sdo.read_value(parameter)
        if (
            cob & (_OFF | _COB_MASK) != pdo.function + node
            or await sdo.read_value(_parameter_object(pdo, 2, 8)) != pdo.kind
        ):
            return False
        if await sdo.read_value(count) != len(pdo.carries):
            return False
        for number, carried_object in enumerate(pdo.carries, start=1):
            if await sdo.read_value(_mapping_object(pdo, number, 32)) != carried_object.mapping_entry:
                return False
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise
        return False
    return await _has_times(sdo, pdo)


async def _has_times(sdo: SdoClient, pdo: PdoMapping) -> bool:
    """Return whether it has its times, which a drive need not support."""
    for obj, value in _list_times(pdo):
        try:
            if await sdo.read_value(obj) != value:
                return False
        except SdoAborted as error:
            if error.abort not in NOT_THERE:
                raise
    return True


def _list_times(pdo: PdoMapping) -> list[tuple[DictionaryObject, int]]:
    """Return the objects of its times that are required, each with its value."""
    times = ((3, pdo.inhibit), (5, pdo.timer))
    return [(_parameter_object(pdo, sub, 16), value) for sub, value in times if value is not None]


class _PdoWriter:
    """Map one PDO in the order that CiA 301 prescribes: switch off, clear, fill, count, switch on. traits: as known up
    to now; an abort that shows another one raises `_OtherTraits`."""

    def __init__(self, sdo: SdoClient, node: int, name: str, traits: PdoTraits) -> None:
        self._sdo = sdo
        self._node = node
        self._name = name
        self._traits = traits

    async def map_pdo(self, pdo: PdoMapping) -> None:
        """Map it. Raises `MappingNotAllowed`, `ControllerFault`, `_OtherTraits`."""
        cob = pdo.function + self._node
        try:
            await self._switch(pdo, cob | _OFF)
            await self._write_kind(pdo)
            for obj, value in _list_times(pdo):
                await _write_if_there(self._sdo, obj, value)
            if not pdo.is_fixed:
                await self._write_objects(pdo)
            await self._switch(pdo, cob)
        except SdoAborted as error:
            raise self._make_fault(pdo.title, error) from None

    async def _switch(self, pdo: PdoMapping, cob: int) -> None:
        """Write the COB-ID; one that cannot be written is compared when the PDO is read back."""
        try:
            await self._sdo.write_value(_parameter_object(pdo, 1, 32), cob)
        except SdoAborted as error:
            if error.abort in NOT_THERE:
                raise _OtherTraits(await self._explore()) from None
            if error.abort != READ_ONLY:
                raise

    async def _write_kind(self, pdo: PdoMapping) -> None:
        kind = _parameter_object(pdo, 2, 8)
        try:
            await self._sdo.write_value(kind, pdo.kind)
        except SdoAborted as error:
            if error.abort != READ_ONLY or pdo.title in self._traits.kinds:
                raise
            held_kind = await self._sdo.read_value(kind)
            if held_kind != pdo.kind:
                kinds = {**self._traits.kinds, pdo.title: held_kind}
                raise _OtherTraits(replace(self._traits, kinds=kinds)) from None

    async def _write_objects(self, pdo: PdoMapping) -> None:
        try:
            await self._sdo.write_value(_mapping_object(pdo, 0, 8), 0)
        except SdoAborted as error:
            if error.abort not in FIXED:
                raise
            await self._switch(pdo, pdo.function + self._node)
            other_traits = await self._explore()
            if pdo.title not in other_traits.fixed:
                raise
            raise _OtherTraits(other_traits) from None
        for number, carried_object in enumerate(pdo.carries, start=1):
            try:
                await self._sdo.write_value(_mapping_object(pdo, number, 32), carried_object.mapping_entry)
            except SdoAborted as error:
                other_traits = self._learn_entry(pdo, number, carried_object, error.abort)
                if other_traits is None:
                    raise self._make_fault(f"{pdo.title}, {carried_object}", error) from None
                raise _OtherTraits(other_traits) from None
        await self._sdo.write_value(_mapping_object(pdo, 0, 8), len(pdo.carries))

    def _learn_entry(self, pdo: PdoMapping, number: int, obj: DictionaryObject, abort: int) -> PdoTraits | None:
        """Return what the abort of an entry shows; None: nothing that could be planned with."""
        traits = self._traits
        match abort:
            case words.NO_OBJECT:
                return replace(traits, absent=traits.absent | {obj})
            case words.NOT_MAPPABLE:
                return replace(traits, unmappable=traits.unmappable | {obj})
            case words.NO_SUBINDEX:
                return replace(traits, rooms={**traits.rooms, pdo.title: number - 1})
            case _:
                return None

    async def _explore(self) -> PdoTraits:
        """Return which PDOs the drive lacks, and which have a fixed mapping: what one lacks, another one may carry."""
        titles = set(self._traits.missing)
        contents = dict(self._traits.fixed)
        for pdo in list_all_pdos():
            cob = _parameter_object(pdo, 1, 32)
            try:
                held_cob = await self._sdo.read_value(cob)
                count = await self._sdo.read_value(_mapping_object(pdo, 0, 8))
            except SdoAborted as error:
                if error.abort not in NOT_THERE:
                    raise
                titles.add(pdo.title)
                continue
            await self._switch(pdo, held_cob | _OFF)
            try:
                await self._sdo.write_value(_mapping_object(pdo, 0, 8), count)
            except SdoAborted as error:
                if error.abort not in FIXED:
                    raise
                contents[pdo.title] = await self._read_objects(pdo)
            await self._switch(pdo, held_cob)
        return replace(self._traits, missing=frozenset(titles), fixed=contents)

    async def _read_objects(self, pdo: PdoMapping) -> tuple[DictionaryObject, ...]:
        """Return what a PDO of fixed mapping carries."""
        count = await self._sdo.read_value(_mapping_object(pdo, 0, 8))
        entries = [await self._sdo.read_value(_mapping_object(pdo, number, 32)) for number in range(1, count + 1)]
        return tuple(read_mapping_entry(entry) for entry in entries)

    def _make_fault(self, place: str, error: SdoAborted) -> TuttiError:
        if error.abort == WRONG_STATE:
            return MappingNotAllowed()
        return ControllerFault(
            "pdo-mapping",
            f"{self._name} refuses the mapping of {place}: {abort_text(error.abort)}",
            "does the drive allow this object in a PDO, and mapping at all? Compare its EDS file and its manual",
        )


async def _write_if_there(sdo: SdoClient, obj: DictionaryObject, value: int) -> None:
    try:
        await sdo.write_value(obj, value)
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise


def _parameter_object(pdo: PdoMapping, sub: int, bits: int) -> DictionaryObject:
    names = {1: "COB-ID", 2: "transmission type", 3: "inhibit time", 5: "event timer"}
    return DictionaryObject(pdo.parameter, sub, bits, f"{names[sub]} of {pdo.title}")


def _mapping_object(pdo: PdoMapping, sub: int, bits: int) -> DictionaryObject:
    return DictionaryObject(pdo.mapping, sub, bits, f"mapping of {pdo.title}")
