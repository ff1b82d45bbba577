"""Touch probes of a drive: captured positions, and moves that end at one."""
