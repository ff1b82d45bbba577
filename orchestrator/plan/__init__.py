"""Planning: targets to synchronised profiles, with Ruckig."""
