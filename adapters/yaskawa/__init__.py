"""Adapters of the Yaskawa SMC-4000 and SMC-2000."""
