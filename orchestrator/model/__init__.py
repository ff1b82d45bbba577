"""The words everybody shares, as values: fleet, job, profile, state, messages, report. Imports nothing of ours."""
