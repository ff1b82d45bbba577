"""What is known of a controller: its status, its steps, its leases, what is kept on disk."""
