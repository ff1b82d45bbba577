"""A table as a data frame of pandas or polars, whichever is installed."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from importlib.util import find_spec
from typing import Any

from orchestrator.model.errors import TuttiError
from orchestrator.monitor.export.table import DataTable

LIBRARIES = ("pandas", "polars")


class NoDataFrames(TuttiError):
    """Neither pandas nor polars is installed, or not the one that was asked for. The text says what to install."""


def make_dataframe(table: DataTable, library: str | None = None) -> Any:
    """The table as a data frame. library: `pandas` or `polars`; None: the first that is installed.

    Raises `NoDataFrames`.
    """
    if library is not None and library not in LIBRARIES:
        raise NoDataFrames(f"{library!r} is no library for data frames here; choose {' or '.join(LIBRARIES)}")
    libraries = [name for name in ([library] if library else LIBRARIES) if find_spec(name) is not None]
    if not libraries:
        library_names = library or " or ".join(LIBRARIES)
        raise NoDataFrames(f"{library_names} is not installed; install it: pip install {library or LIBRARIES[0]}")
    columns = {name: list(values) for name, values in table.columns.items()}
    if libraries[0] == "polars":
        import polars

        return polars.DataFrame(columns, strict=False)
    import pandas

    # Integers with missing values stay integers.
    return pandas.DataFrame(columns).convert_dtypes()
