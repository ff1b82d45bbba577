"""The execution of one job, step by step."""
