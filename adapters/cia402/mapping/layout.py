"""The PDOs of a drive that cannot map all that is required.

What it lacks, cannot map or maps in a fixed way is left out where it can be: a set-point is then written by SDO, and a
mode is read by SDO.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.canopen.pdos import PdoLayout, PdoMapping
from adapters.cia402.mapping.required import AT_ONCE, SYNCHRONOUS, PdoNeeds, list_all_pdos
from orchestrator.model.errors import TuttiError

_LAST_SYNCHRONOUS, _FIRST_EVENT = 240, 254
_MOST_OBJECTS = 8
_PDOS_EACH_WAY = 4
_WITHOUT_PDO = (o.TARGET, o.PROFILE_VELOCITY, o.ACCELERATION, o.MODE_DISPLAY)
"""Objects that are needed, and that SDOs may carry."""
_NUMBERS = ("no", "one", "two", "three", "four")
_STREAM = frozenset({o.TARGET, o.INTERPOLATION_POSITION, o.STATUSWORD, o.DEMAND, o.OUTPUTS})
"""What the PDOs of a stream carry."""


@dataclass(frozen=True, slots=True)
class PdoTraits:
    """What a drive has of all this, by its EDS file or by its answers.

    absent: objects that it lacks. unmappable: objects that no PDO can carry. Of PDOs, by title: missing ones; fixed:
    what a mapping carries that cannot be changed; rooms: how many objects fit, where fewer than eight do; kinds:
    transmission types that cannot be changed."""

    absent: frozenset[DictionaryObject] = frozenset()
    unmappable: frozenset[DictionaryObject] = frozenset()
    missing: frozenset[str] = frozenset()
    fixed: Mapping[str, tuple[DictionaryObject, ...]] = field(default_factory=dict[str, tuple[DictionaryObject, ...]])
    rooms: Mapping[str, int] = field(default_factory=dict[str, int])
    kinds: Mapping[str, int] = field(default_factory=dict[str, int])


class UnsuitablePdos(TuttiError):
    """A drive whose PDOs do not suffice. text: what decides; remedy: the way out."""

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(f"{text}; {remedy}")
        self.text = text
        self.remedy = remedy


class TooFewPdos(UnsuitablePdos):
    """A drive without the PDOs that are needed, whatever they could carry."""


def plan_layout(needs: PdoNeeds, traits: PdoTraits) -> PdoLayout:
    """Return the PDOs for a drive with these traits. Raises `UnsuitablePdos`."""
    return _LayoutPlanner(needs, traits).plan_layout()


class _LayoutPlanner:
    def __init__(self, needs: PdoNeeds, traits: PdoTraits) -> None:
        self._needs = needs
        self._traits = traits
        self._pdos = needs.list_pdos()

    def plan_layout(self) -> PdoLayout:
        traits, needs = self._traits, self._needs
        for way in ("RPDO", "TPDO"):
            self._require_count(way)
        fitted_pdos = [self._fit_pdo(pdo) for pdo in self._pdos if pdo.title not in traits.missing]
        pdos = [*filter(None, fitted_pdos), *self._list_extra()]
        self._require_objects([obj for obj in _WITHOUT_PDO if obj in traits.absent], "no PDO carries")
        layout = PdoLayout(tuple(pdos), traits.absent, "" if needs.followed is None else "TPDO 4")
        reports = [o.STATUSWORD, o.ACTUAL, *((o.INPUTS,) if needs.inputs else ())]
        self._require_objects([obj for obj in reports if obj not in layout.reported], "no TPDO carries")
        return layout

    def _require_count(self, way: str) -> None:
        """Raise `TooFewPdos` where one is missing that is needed, whatever it carries."""
        missing_titles = self._traits.missing
        needed_pdos = [pdo for pdo in self._pdos if pdo.title.startswith(way) and pdo.essential]
        lost_pdos = [pdo for pdo in needed_pdos if pdo.title in missing_titles and not self._may_be_replaced(pdo)]
        if not lost_pdos:
            return
        count = sum(f"{way} {number}" not in missing_titles for number in range(1, _PDOS_EACH_WAY + 1))
        needed_count = max(int(pdo.title[-1]) for pdo in needed_pdos)
        names = ", ".join(f"{pdo.title} ({pdo.parameter:04X}h, {pdo.mapping:04X}h)" for pdo in lost_pdos)
        text = f"{_NUMBERS[count]} {way}{'s' * (count != 1)}, {_NUMBERS[needed_count]} are needed"
        if needed_count == _PDOS_EACH_WAY:
            text += " to stream positions (`jerk`)"
        raise TooFewPdos(f"{text}: no {names}", self._find_remedy({obj for pdo in lost_pdos for obj in pdo.carries}))

    def _may_be_replaced(self, pdo: PdoMapping) -> bool:
        """Return whether a fixed PDO may report what this one is to report."""
        return not pdo.is_received and pdo.kind == AT_ONCE and bool(self._traits.fixed)

    def _fit_pdo(self, pdo: PdoMapping) -> PdoMapping | None:
        """Return a PDO as the drive can have it; None if it is useless, and can be done without."""
        content = self._find_fixed(pdo) if pdo.title in self._traits.fixed else self._choose_objects(pdo)
        kind = self._find_kind(pdo)
        if not content or kind is None:
            return None
        return replace(pdo, carries=content, kind=kind, is_fixed=pdo.title in self._traits.fixed)

    def _choose_objects(self, pdo: PdoMapping) -> tuple[DictionaryObject, ...]:
        """Return what the drive can map to a PDO."""
        traits = self._traits
        objects = [obj for obj in pdo.carries if obj not in traits.absent | traits.unmappable]
        room = traits.rooms.get(pdo.title, _MOST_OBJECTS)
        for obj in reversed(pdo.spare):
            if len(objects) > room and obj in objects:
                objects.remove(obj)
        lost_objects = [obj for obj in pdo.essential if obj not in objects[:room]]
        if not self._may_be_replaced(pdo):
            self._require_objects(lost_objects, f"{pdo.title} cannot carry")
        return tuple(objects)

    def _find_fixed(self, pdo: PdoMapping) -> tuple[DictionaryObject, ...]:
        """Return what a PDO of fixed mapping carries; nothing if that is useless, and can be done without."""
        content = self._traits.fixed[pdo.title]
        if not pdo.is_received and pdo.kind == AT_ONCE:
            return content
        if not pdo.essential:
            return content if set(content) <= set(pdo.carries) else ()
        if content != pdo.carries:
            text = f"the mapping of {pdo.title} is fixed to {_list_objects(content)}"
            raise UnsuitablePdos(f"{text}; needed is {_list_objects(pdo.carries)}", self._find_remedy(pdo.essential))
        return content

    def _find_kind(self, pdo: PdoMapping) -> int | None:
        """Return the transmission type; None if a fixed one makes the PDO useless, and it can be done without."""
        kind = self._traits.kinds.get(pdo.title, pdo.kind)
        last_kind = _LAST_SYNCHRONOUS if pdo.is_received else SYNCHRONOUS
        if kind >= _FIRST_EVENT if pdo.kind == AT_ONCE else kind <= last_kind:
            return kind
        if not pdo.essential:
            return None
        text = f"the transmission type of {pdo.title} is fixed to {kind}; needed is {pdo.kind}"
        raise UnsuitablePdos(text, self._find_remedy(pdo.essential))

    def _list_extra(self) -> list[PdoMapping]:
        """Return PDOs of fixed mapping that the adapter would not map, for what they report."""
        titles = {pdo.title for pdo in self._pdos}
        times = self._needs.times
        return [
            replace(
                pdo,
                kind=AT_ONCE,
                carries=self._traits.fixed[pdo.title],
                inhibit=times.inhibit_ms * 10,
                timer=times.state_ms,
                is_fixed=True,
            )
            for pdo in list_all_pdos()
            if pdo.title in self._traits.fixed and pdo.title not in titles and not pdo.is_received
        ]

    def _require_objects(self, lost: list[DictionaryObject], what: str) -> None:
        """Raise `UnsuitablePdos` for objects that no PDO carries, and that cannot be done without."""
        absent_objects = [obj for obj in lost if obj in self._traits.absent]
        if lost:
            text = f"no {_list_objects(absent_objects)}" if absent_objects else f"{what} {_list_objects(lost)}"
            raise UnsuitablePdos(text, self._find_remedy(lost))

    def _find_remedy(self, lost: Iterable[DictionaryObject]) -> str:
        """Return what to change in the fleet file so that these are not needed; otherwise, that another drive is."""
        objects, needs = set(lost), self._needs
        if needs.followed is not None and objects <= _STREAM and objects != {o.STATUSWORD}:
            return "remove `jerk` from the axis's limits, so that no positions are streamed"
        if needs.outputs and o.OUTPUTS in objects:
            return "remove `outputs` from the controller, so that none are switched at a SYNC"
        if objects == {o.INPUTS}:
            return "remove `inputs` from the controller"
        return "another drive, or another firmware of it, is needed; see its manual for its PDO mapping"


def _list_objects(objects: Iterable[DictionaryObject]) -> str:
    return ", ".join(str(obj) for obj in objects) or "nothing"
