"""The rest of a job that has ended on its way, from its definition and what the journal has of its run."""
