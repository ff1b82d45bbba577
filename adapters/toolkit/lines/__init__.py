"""A driver for controllers with simple text lines, which the host starts and which move in trapezoids.

A make describes its controller's language as a `LineDialect`; everything else is here.
"""
