"""The command language: parsing and expressions."""
