"""What stages of the campaign have besides the others: parts of fleets, and jobs."""
