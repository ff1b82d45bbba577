"""A ready driver for controllers with simple text lines: a make states their language, as a `LineDialect`."""

from adapters.toolkit.lines.dialect import (
    LineAxisStatus,
    LineDialect,
    LineMeaning,
    LineSetting,
    LineState,
    LineStatus,
    LineStep,
    LineTarget,
    LineTraits,
)
from adapters.toolkit.lines.driver import LineDriver
from adapters.toolkit.lines.lowering import CountScale
from adapters.toolkit.lines.options import LineOptions

__all__ = [
    "CountScale",
    "LineAxisStatus",
    "LineDialect",
    "LineDriver",
    "LineMeaning",
    "LineOptions",
    "LineSetting",
    "LineState",
    "LineStatus",
    "LineStep",
    "LineTarget",
    "LineTraits",
]
