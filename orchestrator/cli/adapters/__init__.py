"""`tutti adapter`: makes of others."""
