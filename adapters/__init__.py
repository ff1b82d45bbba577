"""Adapters: the packages that drive controllers of each make and represent them on the bus."""
