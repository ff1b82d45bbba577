"""`tutti estop --armed`: a button in software, with a session of its own."""
