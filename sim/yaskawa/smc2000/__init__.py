"""What the SMC-2000 has of its own."""
