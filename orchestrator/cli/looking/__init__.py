"""Commands that look at a run afterwards: logs, timelines, plots, traces."""
