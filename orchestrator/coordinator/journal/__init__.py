"""The journal: what was accepted, decided and done. `store.py` says what it keeps, `sqlite/` keeps it."""
