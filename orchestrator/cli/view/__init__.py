"""What people look at: states, logs, plots, statistics, alarms."""
