"""The optional EDS file of a drive: its objects are known before the connection, and the product can be verified."""

from collections.abc import Iterator
from dataclasses import dataclass

from canopen import ObjectDictionary

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.eds_file import read_dictionary
from adapters.cia402.canopen.objects import DictionaryObject, read_mapping_entry
from adapters.cia402.canopen.pdos import PdoMapping
from adapters.cia402.fleetaxes import needs_stream
from adapters.cia402.mapping.layout import PdoTraits, TooFewPdos, UnsuitablePdos, plan_layout
from adapters.cia402.mapping.required import list_all_pdos
from adapters.cia402.needs import NEEDS, AskedDrive, ObjectNeed, make_pdo_needs
from adapters.cia402.options import Cia402Options
from adapters.contract import require_no_problems
from orchestrator.model.fleet import Controller

_MOST_OBJECTS = 8
_PDO_OBJECTS = frozenset(
    {
        o.CONTROLWORD,
        o.STATUSWORD,
        o.MODE,
        o.MODE_DISPLAY,
        o.DEMAND,
        o.ACTUAL,
        o.VELOCITY,
        o.TARGET,
        o.PROFILE_VELOCITY,
        o.ACCELERATION,
        o.DECELERATION,
        o.INPUTS,
        o.OUTPUTS,
        o.INTERPOLATION_POSITION,
    }
)


@dataclass(frozen=True, slots=True)
class DriveProduct:
    """The vendor and product numbers of a drive (1018h:1 and 2)."""

    vendor: int | None
    product: int | None


def read_product(path: str, config: Controller, options: Cia402Options) -> DriveProduct:
    """Return the product of an EDS file that contains everything that the adapter maps, reads and writes. Raises
    `ConfigError`."""
    require_no_problems(find_problems(path, config, options))
    device = read_dictionary(path).device_information
    return DriveProduct(device.vendor_number, device.product_number)


def find_problems(path: str, config: Controller, options: Cia402Options) -> list[str]:
    """What decides that a drive with this EDS file cannot do what the fleet file asks for: one line, or none."""
    try:
        dictionary = read_dictionary(path)
    except ValueError as error:
        return [f"options.eds: {error}"]
    reason = _find_reason(dictionary, AskedDrive(config, options, _find_followed(dictionary, config)))
    return [f"options.eds: {reason} ({path})"] if reason else []


def _find_reason(dictionary: ObjectDictionary, asked: AskedDrive) -> str:
    """Return what decides, the most decisive first: too few PDOs, objects that it lacks, what its PDOs carry."""
    needs = make_pdo_needs(asked.config, asked.options, asked.followed)
    pdo_text = ""
    try:
        plan_layout(needs, _read_traits(dictionary))
    except TooFewPdos as error:
        return str(error)
    except UnsuitablePdos as error:
        pdo_text = str(error)
    return _list_lacks(dictionary, asked) or pdo_text


def _list_lacks(dictionary: ObjectDictionary, asked: AskedDrive) -> str:
    gaps: list[str] = []
    remedies: list[str] = []
    for need in NEEDS:
        texts = list(_find_lacks(dictionary, asked, need)) if need.applies(asked) else []
        if texts:
            gaps.append(f"{', '.join(texts)}, needed for {need.purpose}")
            remedies.append(need.remedy)
    return "; ".join(dict.fromkeys([*gaps, *remedies]))


def _find_lacks(dictionary: ObjectDictionary, asked: AskedDrive, need: ObjectNeed) -> Iterator[str]:
    for obj in need.objects:
        variable = dictionary.get_variable(obj.index, obj.sub)
        if variable is None:
            yield f"no {obj}"
        elif obj.bits and len(variable) != obj.bits:
            yield f"{obj} has {len(variable)} bits, not {obj.bits}"
        elif need.is_written and "w" not in variable.access_type:
            wanted_value = asked.find_value(obj)
            # A file need not state the value of a constant.
            if wanted_value is None or variable.default not in (None, wanted_value):
                yield f"{obj} cannot be written ({variable.access_type})"


def _find_followed(dictionary: ObjectDictionary, config: Controller) -> DictionaryObject | None:
    """Return the object of the positions that are streamed to the drive; None: none are, or the drive has no mode for
    it."""
    if not needs_stream(config):
        return None
    supported_modes = dictionary.get_variable(o.SUPPORTED_MODES.index, 0)
    modes = 0 if supported_modes is None else int(supported_modes.default or 0)
    for mode, obj in o.FOLLOWED.items():
        # A file need not state the value of 6502h.
        if dictionary.get_variable(obj.index, obj.sub) is not None and (not modes or modes >> mode - 1 & 1):
            return obj
    return None


def _read_traits(dictionary: ObjectDictionary) -> PdoTraits:
    """Return what the file says of objects in PDOs, and of all PDOs that the adapter may use."""
    variables = {obj: dictionary.get_variable(obj.index, obj.sub) for obj in _PDO_OBJECTS}
    absent_objects = {obj for obj, variable in variables.items() if variable is None}
    sdo_objects = {obj for obj, variable in variables.items() if variable is not None and not variable.pdo_mappable}
    missing_titles: set[str] = set()
    contents: dict[str, tuple[DictionaryObject, ...]] = {}
    rooms: dict[str, int] = {}
    kinds: dict[str, int] = {}
    for pdo in list_all_pdos():
        if dictionary.get_variable(pdo.parameter, 1) is None or dictionary.get_variable(pdo.mapping, 0) is None:
            missing_titles.add(pdo.title)
            continue
        rooms[pdo.title] = len(_list_entries(dictionary, pdo))
        if _is_fixed(dictionary, pdo.mapping, 0) or _is_fixed(dictionary, pdo.mapping, 1):
            contents[pdo.title] = _read_fixed(dictionary, pdo)
        kind = dictionary.get_variable(pdo.parameter, 2)
        if kind is not None and kind.default is not None and "w" not in kind.access_type:
            kinds[pdo.title] = int(kind.default)
    return PdoTraits(
        frozenset(absent_objects), frozenset(sdo_objects), frozenset(missing_titles), contents, rooms, kinds
    )


def _is_fixed(dictionary: ObjectDictionary, index: int, sub: int) -> bool:
    variable = dictionary.get_variable(index, sub)
    return variable is not None and "w" not in variable.access_type


def _list_entries(dictionary: ObjectDictionary, pdo: PdoMapping) -> list[int]:
    """Return the default values of its entries, as many as it has."""
    variables = [dictionary.get_variable(pdo.mapping, sub) for sub in range(1, _MOST_OBJECTS + 1)]
    return [int(variable.default or 0) for variable in variables if variable is not None]


def _read_fixed(dictionary: ObjectDictionary, pdo: PdoMapping) -> tuple[DictionaryObject, ...]:
    count = dictionary.get_variable(pdo.mapping, 0)
    most = _MOST_OBJECTS if count is None or count.default is None else int(count.default)
    return tuple(read_mapping_entry(entry) for entry in _list_entries(dictionary, pdo)[:most] if entry)
