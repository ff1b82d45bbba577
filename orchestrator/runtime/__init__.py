"""Complete fleets: live on this machine or in virtual time."""
