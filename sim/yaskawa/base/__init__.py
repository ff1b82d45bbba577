"""Values, units and errors of the simulated Yaskawa controllers."""
