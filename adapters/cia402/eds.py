"""The EDS file of a drive, if there is one: what it has is known before it is met, and that it is the one meant."""

from collections.abc import Sequence
from configparser import Error as NoIniFile
from dataclasses import dataclass

from canopen import ObjectDictionary, import_od

from adapters.cia402.objects import Obj
from adapters.cia402.pdo import Pdo


@dataclass(frozen=True, slots=True)
class Product:
    """Who makes the drive, and which one it is (1018h:1 and 2)."""

    vendor: int | None
    product: int | None


def read(path: str, pdos: Sequence[Pdo]) -> Product:
    """The product of an EDS file that has everything that the adapter maps. Raises `ValueError`."""
    try:
        # The number of the node matters for defaults only.
        dictionary = import_od(path, 1)
    except (OSError, NoIniFile, ValueError, KeyError) as error:
        raise ValueError(f"options.eds: {path} can not be read as an EDS file: {error}") from None
    for pdo in pdos:
        for obj in pdo.carries:
            _require(path, dictionary, pdo, obj)
    device = dictionary.device_information
    return Product(device.vendor_number, device.product_number)


def _require(path: str, dictionary: ObjectDictionary, pdo: Pdo, obj: Obj) -> None:
    variable = dictionary.get_variable(obj.index, obj.sub)
    if variable is None:
        raise ValueError(f"options.eds: {path} has no {obj}, which {pdo.title} must carry")
    if not variable.pdo_mappable:
        raise ValueError(f"options.eds: by {path} no PDO can carry {obj}, and {pdo.title} must")
    if len(variable) != obj.bits:
        raise ValueError(f"options.eds: by {path} {obj} has {len(variable)} bits, not {obj.bits}")
