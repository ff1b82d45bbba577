"""Links: bytes with time stamps, and in-memory links that model a wire. No drivers."""
