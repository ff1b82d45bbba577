"""Tutti: the service, and the words everybody shares."""
