"""The adapter of the Yaskawa SMC-2000."""
