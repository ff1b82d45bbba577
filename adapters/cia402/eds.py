"""The optional EDS file of a drive: its objects are known before the connection, and the product can be verified."""

from collections.abc import Callable, Iterator
from configparser import Error as NoIniFile
from dataclasses import dataclass
from functools import partial
from io import StringIO
from pathlib import Path

from canopen import ObjectDictionary, ObjectDictionaryError, import_od

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.fleetaxes import needs_stream
from adapters.cia402.options import Cia402Options
from adapters.cia402.pdo import PdoMapping, parameter_values, required_pdos
from adapters.contract import require_no_problems
from orchestrator.model.fleet import Controller

_READ = (o.DEVICE_TYPE, o.STATUSWORD, o.MODE_DISPLAY, o.DEMAND, o.ACTUAL, o.INPUTS)
_WRITTEN = (
    o.HEARTBEAT,
    o.CONTROLWORD,
    o.MODE,
    o.TARGET,
    o.PROFILE_VELOCITY,
    o.ACCELERATION,
    o.DECELERATION,
    o.HOMING_METHOD,
    o.HOMING_SWITCH_SPEED,
    o.HOMING_ZERO_SPEED,
)
"""All other objects are optional: without them a drive does what their defaults in the standard state."""


@dataclass(frozen=True, slots=True)
class DriveProduct:
    """The vendor and product numbers of a drive (1018h:1 and 2)."""

    vendor: int | None
    product: int | None


def read_product(path: str, config: Controller, options: Cia402Options) -> DriveProduct:
    """Return the product of an EDS file that contains everything that the adapter maps, reads and writes. Raises
    `ConfigError`."""
    require_no_problems(find_problems(path, config, options))
    device = _read_dictionary(path).device_information
    return DriveProduct(device.vendor_number, device.product_number)


def find_problems(path: str, config: Controller, options: Cia402Options) -> list[str]:
    """Everything that the adapter maps, reads or writes, and that the EDS file lacks."""
    try:
        dictionary = _read_dictionary(path)
    except ValueError as error:
        return [str(error)]
    problems: list[str] = []
    for check in _make_checks(path, dictionary, config, options):
        try:
            check()
        except ValueError as error:
            problems.append(str(error))
    return list(dict.fromkeys(problems))


def _make_checks(
    path: str, dictionary: ObjectDictionary, config: Controller, options: Cia402Options
) -> Iterator[Callable[[], object]]:
    """One check for each object."""
    for pdo in required_pdos(options, outputs=bool(config.outputs), followed=_find_followed(dictionary, config)):
        for obj in pdo.carries:
            yield partial(_require_mappable, path, dictionary, pdo, obj)
        # Inhibit time and event timer need not exist.
        for obj, _ in parameter_values(pdo, 0):
            if obj.sub not in (3, 5) or obj.index == pdo.mapping:
                yield partial(_require_object, path, dictionary, obj, f"and {pdo.title} must be set up")
    for obj in _READ:
        yield partial(_require_object, path, dictionary, obj, "which the adapter reads")
    for name, pair in (("encoder", o.ENCODER), ("gear", o.GEAR), ("feed", o.FEED)):
        if getattr(options, name) is not None:
            for obj in pair:
                yield partial(_require_object, path, dictionary, obj, f"which option `{name}` compares")
    for obj, purpose in _written_objects(config, options, dictionary):
        yield partial(_require_writable, path, dictionary, obj, purpose)


def _require_writable(path: str, dictionary: ObjectDictionary, obj: DictionaryObject, why: str) -> None:
    access = _require_object(path, dictionary, obj, why)
    if "w" not in access:
        raise ValueError(f"options.eds: according to {path} {obj} cannot be written ({access}), {why}")


def _read_dictionary(path: str) -> ObjectDictionary:
    """Read the file. The standard states ASCII; makers' tools write UTF-8, or the code page of their Windows."""
    try:
        data = Path(path).read_bytes()
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")
        if "[DeviceInfo]" not in text:
            raise ValueError("it has no section DeviceInfo")
        source = StringIO(text)
        source.name = path  # its suffix states the format
        # The node number only affects defaults.
        return import_od(source, 1)
    except (OSError, NoIniFile, ValueError, KeyError, AttributeError, ObjectDictionaryError) as error:
        raise ValueError(f"options.eds: {path} cannot be read as an EDS file: {error}") from None


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


def _written_objects(
    config: Controller, options: Cia402Options, dictionary: ObjectDictionary
) -> Iterator[tuple[DictionaryObject, str]]:
    """Yield the objects that are written with these options, each with the reason."""
    for obj in _WRITTEN:
        yield obj, "which the adapter writes"
    if options.quick_stop_acceleration is not None:
        yield o.QUICK_STOP_DECELERATION, "which `quick_stop_acceleration` sets"
    if options.watchdog_ms is not None:
        for obj in (o.ABORT_CONNECTION_OPTION, o.CONSUMER):
            yield obj, "which `watchdog_ms` sets"
    if _find_followed(dictionary, config) is not None:
        for obj in (o.PERIOD, o.PERIOD_INDEX):
            yield obj, "which streaming for the axis's `jerk` sets"


def _require_object(path: str, dictionary: ObjectDictionary, obj: DictionaryObject, why: str) -> str:
    """Return the access type of an object that must exist. Raises `ValueError`."""
    variable = dictionary.get_variable(obj.index, obj.sub)
    if variable is None:
        raise ValueError(f"options.eds: {path} has no {obj}, {why}")
    if obj.bits and len(variable) != obj.bits:
        raise ValueError(f"options.eds: by {path} {obj} has {len(variable)} bits, not {obj.bits}")
    return variable.access_type


def _require_mappable(path: str, dictionary: ObjectDictionary, pdo: PdoMapping, obj: DictionaryObject) -> None:
    _require_object(path, dictionary, obj, f"which {pdo.title} must carry")
    variable = dictionary.get_variable(obj.index, obj.sub)
    if variable is not None and not variable.pdo_mappable:
        raise ValueError(f"options.eds: according to {path} no PDO can carry {obj}, and {pdo.title} must")
