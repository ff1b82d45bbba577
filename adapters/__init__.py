"""Adapters: what drives controllers of each make and presents them on the bus."""
