"""Values shared by all packages: fleet, job, profile, state, messages, report, errors. Imports no other package of
Tutti."""
