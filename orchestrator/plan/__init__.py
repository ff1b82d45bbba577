"""Jobs to synchronised profiles, with Ruckig."""
