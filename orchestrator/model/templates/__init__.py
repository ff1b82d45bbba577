"""Job files with parameters: what they declare, and the jobs that their values make."""
