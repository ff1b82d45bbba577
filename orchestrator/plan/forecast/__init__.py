"""Run a job forward on paper: what checks each kind of step ahead is one module here; see `job.py`."""
