"""What adapter hosts publish of their controllers: frames of a host, and the feed that reads them."""
