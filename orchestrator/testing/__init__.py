"""Fleets for tests of jobs and scripts: virtual ones in virtual time, and live ones of simulated controllers."""
