"""What only listens: views of the fleet for people."""
