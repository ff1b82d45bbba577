"""The gateway: the HTTP interface of a fleet, and the operators' page."""
