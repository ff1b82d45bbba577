"""`tutti watch`: the fleet, live in a terminal."""
