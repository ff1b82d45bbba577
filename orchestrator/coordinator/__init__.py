"""Queue, arm/commit/go, supervision, journal and reports: the one who decides."""
