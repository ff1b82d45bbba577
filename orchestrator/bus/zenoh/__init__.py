"""The bus over Zenoh."""
