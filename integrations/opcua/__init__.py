"""A fleet for clients of OPC UA: job orders of OPC 10031-4, axes, e-stop."""
