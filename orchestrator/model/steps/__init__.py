"""The kinds of steps of a job, one module each. A kind answers every question about itself; see `base.Step`."""
