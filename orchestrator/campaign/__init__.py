"""The fault campaign: random fleets, jobs and faults in virtual time, checked against the invariants."""
