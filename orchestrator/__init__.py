"""Tutti: the service, and the terms that all its parts share."""
