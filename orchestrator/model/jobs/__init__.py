"""The job, the files of jobs and fleets, and requests about jobs."""
