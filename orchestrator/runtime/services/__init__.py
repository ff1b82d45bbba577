"""Tutti as services of systemd."""
