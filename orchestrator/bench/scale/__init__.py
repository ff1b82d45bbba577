"""How the work of a fleet grows with its controllers: counts and processor times, in virtual time and live."""
