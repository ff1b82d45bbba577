"""Commands and options for the parameters of job files."""
