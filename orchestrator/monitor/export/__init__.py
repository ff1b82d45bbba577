"""Export of recordings and reports as tables: Parquet, CSV, HDF5, data frames."""
