"""Recorders of what a campaign's fleet does on the bus."""
