"""The EDS or DCF file of a drive as text, read by the standard (CiA 306).

The standard states ASCII; makers' tools write UTF-8, or the code page of their Windows.
"""

import re
from configparser import Error as NoIniFile
from io import StringIO
from pathlib import Path

from canopen import ObjectDictionary, ObjectDictionaryError, import_od

from orchestrator.model.files.yaml_reader import explain_mark

_SECTION = re.compile(r"\s*\[(.+)\]")
_ENTRY = re.compile(r"\s*(\w+)\s*=\s*([^;]*)")
_FORMULA = re.compile(r"\$NODEID|\+|\s", re.IGNORECASE)
_VALUES = frozenset({"DefaultValue", "ParameterValue"})
_NUMBERS = frozenset(
    {"DataType", "ObjectType", "PDOMapping", "LowLimit", "HighLimit", "VendorNumber", "ProductNumber", "RevisionNumber"}
)
_TEXT_TYPES = frozenset({0x09, 0x0A, 0x0B, 0x0F})
# Python reads `1_0` and digits of other scripts as numbers; the standard and a fleet file do not.
_ODD_NUMBER = re.compile(r"[-+]?(?:0[xX])?(?=.*[^0-9a-fA-F])[\w]+")


def read_dictionary(path: str) -> ObjectDictionary:
    """Read the file. Raises `ValueError` with what is wrong with it."""
    try:
        text = _decode(Path(path).read_bytes())
        if "[DeviceInfo]" not in text:
            raise ValueError("it has no section DeviceInfo")
        _require_numbers(text)
        source = StringIO(text)
        source.name = path  # its suffix states the format
        # The node number only affects defaults.
        return import_od(source, 1)
    except (OSError, NoIniFile, ValueError, KeyError, AttributeError, ObjectDictionaryError) as error:
        raise ValueError(f"{path} cannot be read as an EDS file: {error}") from None


def _decode(data: bytes) -> str:
    if mark := explain_mark(data):
        raise ValueError(f"it {mark}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _require_numbers(text: str) -> None:
    """Raise `ValueError` for a number that only Python reads as one."""
    data_type = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if _SECTION.match(line):
            data_type = ""
        entry = _ENTRY.match(line)
        if entry is None:
            continue
        name, value = entry[1], entry[2].strip()
        digits = _FORMULA.sub("", value)
        if name == "DataType":
            data_type = value
        is_number = name in _NUMBERS or (name in _VALUES and not _is_text(data_type))
        if is_number and ("_" in digits or not digits.isascii()) and _ODD_NUMBER.fullmatch(digits):
            raise ValueError(f"line {number}: {name} is {value}, which is no number; write its digits alone")


def _is_text(data_type: str) -> bool:
    try:
        return int(data_type, 0) in _TEXT_TYPES
    except ValueError:
        return True
