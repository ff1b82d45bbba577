"""Tables written as files: Parquet, CSV and HDF5."""

# pyarrow and h5py type their functions only in part.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportMissingTypeStubs=false
# pyright: reportUnknownArgumentType=false

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from orchestrator.monitor.export.csv_table import USUAL_STYLE, CsvStyle, CsvTable
from orchestrator.monitor.export.table import Column, DataTable

TableFormat = Literal["parquet", "csv", "hdf5"]
SUFFIXES: Mapping[TableFormat, str] = {"parquet": ".parquet", "csv": ".csv", "hdf5": ".h5"}
SCHEMA = "tutti.table/1"


def write_tables(
    tables: Sequence[DataTable], path: Path, table_format: TableFormat, style: CsvStyle = USUAL_STYLE
) -> list[Path]:
    """Write tables, and return the files: for HDF5 one at `path`; else one a table, the first one at `path`, and the
    others with their names before the suffix. Metadata of CSV files stand in one JSON file beside them. style: of CSV.

    Raises `OSError`; files that exist are replaced.
    """
    if table_format == "hdf5":
        return [_write_hdf5(tables, path)]
    write = _write_parquet if table_format == "parquet" else partial(_write_csv, style)
    suffix = SUFFIXES[table_format]
    files = [path, *(path.with_name(f"{path.stem}.{table.name}{suffix}") for table in tables[1:])]
    for table, file in zip(tables, files, strict=True):
        _replace_whole(file, lambda path, table=table: write(table, path))
    if table_format == "csv":
        about = path.with_suffix(".json")
        text = json.dumps({table.name: _describe(table) for table in tables}, indent=2)
        _replace_whole(about, lambda path: path.write_text(f"{text}\n", encoding="utf-8"))
        files.append(about)
    return files


def _replace_whole(file: Path, write: Callable[[Path], object]) -> None:
    """Write a file beside its place first: one that is there is replaced as a whole."""
    fresh = file.with_name(f"{file.name}.new")
    try:
        write(fresh)
        fresh.replace(file)
    finally:
        fresh.unlink(missing_ok=True)


def _describe(table: DataTable) -> dict[str, Any]:
    return {"schema": SCHEMA, "table": table.name, "units": dict(table.units), **table.metadata}


def _write_parquet(table: DataTable, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields: list[Any] = []
    arrays: list[Any] = []
    for name, values in table.columns.items():
        array = pa.array(values)
        unit = table.units.get(name)
        fields.append(pa.field(name, array.type, metadata={"unit": unit} if unit else None))
        arrays.append(array)
    about = _describe(table)
    metadata = {key: value if isinstance(value, str) else json.dumps(value) for key, value in about.items()}
    schema = pa.schema(fields, metadata=metadata)
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), path, compression="zstd")


def _write_csv(style: CsvStyle, table: DataTable, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv_table = CsvTable(file, style)
        csv_table.write_row(table.columns)
        columns = [list(values) for values in table.columns.values()]
        csv_table.write_rows(zip(*columns, strict=True))


def _write_hdf5(tables: Sequence[DataTable], path: Path) -> Path:
    _replace_whole(path, lambda file_path: _fill_hdf5(tables, file_path))
    return path


def _fill_hdf5(tables: Sequence[DataTable], path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for table in tables:
            group = file.create_group(table.name)
            for key, value in _describe(table).items():
                group.attrs[key] = value if isinstance(value, str) else json.dumps(value)
            for name, values in table.columns.items():
                dataset = group.create_dataset(name, data=_hdf5_values(values), compression="gzip", shuffle=True)
                if name in table.units:
                    dataset.attrs["units"] = table.units[name]


def _hdf5_values(values: Column) -> Any:
    """The values as an array; HDF5 has no missing ones: NaN stands for a number, and "" for a text."""
    import h5py
    import numpy as np

    if isinstance(values, np.ndarray):
        return values
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {bool} and None not in values:
        return np.array(values, dtype=bool)
    if kinds == {str}:
        return np.array([value or "" for value in values], dtype=h5py.string_dtype())
    if kinds <= {int} and None not in values:
        return np.array(values, dtype=np.int64)
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
