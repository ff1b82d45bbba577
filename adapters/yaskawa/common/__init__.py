"""Code shared by both Yaskawa models."""
