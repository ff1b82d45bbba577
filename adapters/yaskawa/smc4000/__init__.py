"""The adapter of the Yaskawa SMC-4000."""
