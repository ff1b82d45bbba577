"""The optional EDS file of a drive: its objects are known before the connection, and the product can be verified."""

from collections.abc import Sequence
from configparser import Error as NoIniFile
from dataclasses import dataclass

from canopen import ObjectDictionary, import_od

from adapters.cia402.objects import DictionaryObject
from adapters.cia402.pdo import PdoMapping


@dataclass(frozen=True, slots=True)
class DriveProduct:
    """The vendor and product numbers of a drive (1018h:1 and 2)."""

    vendor: int | None
    product: int | None


def read_product(path: str, pdos: Sequence[PdoMapping]) -> DriveProduct:
    """Return the product of an EDS file that contains everything that the adapter maps. Raises `ValueError`."""
    try:
        # The node number only affects defaults.
        dictionary = import_od(path, 1)
    except (OSError, NoIniFile, ValueError, KeyError) as error:
        raise ValueError(f"options.eds: {path} cannot be read as an EDS file: {error}") from None
    for pdo in pdos:
        for obj in pdo.carries:
            _require_object(path, dictionary, pdo, obj)
    device = dictionary.device_information
    return DriveProduct(device.vendor_number, device.product_number)


def _require_object(path: str, dictionary: ObjectDictionary, pdo: PdoMapping, obj: DictionaryObject) -> None:
    variable = dictionary.get_variable(obj.index, obj.sub)
    if variable is None:
        raise ValueError(f"options.eds: {path} has no {obj}, which {pdo.title} must carry")
    if not variable.pdo_mappable:
        raise ValueError(f"options.eds: according to {path} no PDO can carry {obj}, and {pdo.title} must")
    if len(variable) != obj.bits:
        raise ValueError(f"options.eds: by {path} {obj} has {len(variable)} bits, not {obj.bits}")
