"""The timeline of the motion steps of a job: their stages from the report, as a table, as a picture, and as JSON."""
