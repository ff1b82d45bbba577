"""The form in which points of a scan are sent and stored: rows of doubles, behind a line that names the columns."""

import json
from collections.abc import Sequence

from orchestrator.model.base import Model
from orchestrator.model.units import Unit

ROW_TYPE = "<f8"  # of a value, for numpy: a double, little-endian
VALUE_BYTES = 8
PART_BYTES = 700_000  # of points in one request; some 0.95 MB as text


class PointAxis(Model):
    """A column of points: an axis, and the unit of its values."""

    axis: str
    unit: Unit


def make_header(axes: Sequence[PointAxis]) -> bytes:
    """The line before the rows; it belongs to the digest, so that points fit only these axes and units."""
    return json.dumps([each.to_plain() for each in axes], separators=(",", ":")).encode() + b"\n"


def find_row_bytes(axes: Sequence[PointAxis]) -> int:
    """The bytes of one point."""
    return len(axes) * VALUE_BYTES
