"""Which requests are allowed: users, roles, sessions and tokens."""
