"""Parts that only the SMC-2000 has."""
